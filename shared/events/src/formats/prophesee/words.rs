//! Words of a fixed number of bytes, out of pieces cut anywhere.

/// What is left of the piece before.
#[derive(Debug, Clone)]
pub(super) struct Words<const N: usize> {
    rest: [u8; N],
    len: usize,
}

impl<const N: usize> Words<N> {
    pub(super) fn new() -> Self {
        Self { rest: [0; N], len: 0 }
    }

    /// Bytes of an unfinished word.
    pub(super) fn pending(&self) -> usize {
        self.len
    }

    /// The words that are whole now: first the one that was begun in an earlier piece, if it is finished here, then
    /// all others of this piece. What is left over is kept.
    pub(super) fn split<'a>(&mut self, mut bytes: &'a [u8]) -> (Option<[u8; N]>, &'a [[u8; N]]) {
        let mut first = None;
        if self.len > 0 {
            let n = bytes.len().min(N - self.len);
            let (head, tail) = bytes.split_at(n);
            self.rest[self.len..self.len + n].copy_from_slice(head);
            self.len += n;
            bytes = tail;
            if self.len < N {
                return (None, &[]);
            }
            first = Some(self.rest);
        }
        let (whole, rest) = bytes.as_chunks::<N>();
        self.rest[..rest.len()].copy_from_slice(rest);
        self.len = rest.len();
        (first, whole)
    }
}
