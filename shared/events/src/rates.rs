//! How many events there are over the time of a recording, and its longest gaps, in bounded memory.

/// Most bins: beyond, their length doubles.
const MOST_BINS: usize = 8192;
/// Gaps that are kept.
const MOST_GAPS: usize = 5;

/// Events in consecutive bins of time.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct RateOverTime {
    /// Length of a bin, ns. It is doubled whenever there would be more than 8192 bins.
    pub bin_ns: u64,
    /// Events in each bin from the first event on; the last bin is not whole. Events earlier than the first event count
    /// into the first bin.
    pub events: Vec<u64>,
}

impl RateOverTime {
    pub(crate) fn new(bin_ns: u64) -> Self {
        Self {
            bin_ns: bin_ns.max(1),
            events: Vec::new(),
        }
    }

    /// Counts an event, so long after the first one.
    #[inline]
    pub(crate) fn add(&mut self, after_first_ns: u64) {
        let mut bin = after_first_ns / self.bin_ns;
        while bin >= MOST_BINS as u64 {
            self.halve();
            bin = after_first_ns / self.bin_ns;
        }
        let bin = bin as usize;
        if bin >= self.events.len() {
            self.events.resize(bin + 1, 0);
        }
        self.events[bin] += 1;
    }

    fn halve(&mut self) {
        self.bin_ns = self.bin_ns.saturating_mul(2);
        self.events = self.events.chunks(2).map(|pair| pair.iter().sum()).collect();
    }

    /// Events per second in this many columns or fewer, each of whole bins; and how long a column is, ns.
    pub fn columns(&self, most: usize) -> (Vec<f64>, u64) {
        let per_column = self.events.len().div_ceil(most.max(1)).max(1);
        let column_ns = self.bin_ns.saturating_mul(per_column as u64);
        let rates = self.events.chunks(per_column).map(|bins| {
            let seconds = self.bin_ns as f64 * bins.len() as f64 / 1e9;
            bins.iter().sum::<u64>() as f64 / seconds
        });
        (rates.collect(), column_ns)
    }
}

/// A stretch of time without events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Gap {
    /// Time of the event before it, ns.
    pub from_ns: u64,
    /// How long it is, ns.
    pub length_ns: u64,
}

/// The longest gaps, longest first; of equal ones the earlier.
#[derive(Debug, Default)]
pub(crate) struct LongestGaps(Vec<Gap>);

impl LongestGaps {
    #[inline]
    pub(crate) fn add(&mut self, from_ns: u64, to_ns: u64) {
        let length_ns = to_ns.saturating_sub(from_ns);
        let least = match self.0.last() {
            Some(gap) if self.0.len() == MOST_GAPS => gap.length_ns,
            _ => 0,
        };
        if length_ns > least {
            self.insert(Gap { from_ns, length_ns });
        }
    }

    fn insert(&mut self, gap: Gap) {
        let at = self.0.partition_point(|g| g.length_ns >= gap.length_ns);
        self.0.insert(at, gap);
        self.0.truncate(MOST_GAPS);
    }

    pub(crate) fn into_vec(self) -> Vec<Gap> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[test]
    fn bins_are_seconds_and_double_when_there_are_too_many() {
        let mut rate = RateOverTime::new(S);
        for t in [0, S - 1, S, 3 * S] {
            rate.add(t);
        }
        assert_eq!((rate.bin_ns, rate.events.clone()), (S, vec![2, 1, 0, 1]));
        rate.add(8191 * S);
        assert_eq!((rate.bin_ns, rate.events.len()), (S, 8192));
        rate.add(8192 * S);
        assert_eq!((rate.bin_ns, rate.events.len()), (2 * S, 4097));
        assert_eq!((rate.events[0], rate.events[1], rate.events[4095]), (3, 1, 1));
        // A damaged time does not take the memory.
        rate.add(u64::MAX);
        assert!(rate.events.len() <= MOST_BINS);
        assert_eq!(rate.events.iter().sum::<u64>(), 7);
    }

    #[test]
    fn columns_are_of_whole_bins() {
        let rate = RateOverTime {
            bin_ns: S,
            events: vec![2, 4, 6, 8, 10],
        };
        assert_eq!(rate.columns(10), (vec![2.0, 4.0, 6.0, 8.0, 10.0], S));
        assert_eq!(rate.columns(3), (vec![3.0, 7.0, 10.0], 2 * S));
        assert_eq!(rate.columns(0), (vec![6.0], 5 * S));
        assert_eq!(RateOverTime::new(S).columns(3), (vec![], S));
    }

    #[test]
    fn the_five_longest_gaps_are_kept() {
        let mut gaps = LongestGaps::default();
        for (from, length) in [
            (0, 3),
            (10, 9),
            (20, 0),
            (30, 5),
            (40, 9),
            (50, 1),
            (60, 2),
            (70, 4),
        ] {
            gaps.add(from, from + length);
        }
        let kept: Vec<_> = gaps.into_vec().iter().map(|g| (g.from_ns, g.length_ns)).collect();
        assert_eq!(kept, [(10, 9), (40, 9), (30, 5), (70, 4), (0, 3)]);
    }
}
