//! How fast ONNX Runtime multiplies matrices here: what a network's operations are divided by to say how fast it could
//! be.

use crate::error::{OnnxError, one_line};
use crate::library::Library;
use ort::session::Session;
use ort::value::TensorRef;
use std::time::{Duration, Instant};

/// Rows and columns of the matrices.
const SIDE: usize = 1024;
/// The best of the products in this time counts.
const PERIOD: Duration = Duration::from_millis(700);

/// Multiplications with additions per second, in thousands of millions, of matrix products of f32 on so many threads of
/// the CPU.
///
/// # Errors
/// When ONNX Runtime cannot compute one.
pub fn peak_gmacs(library: &Library, threads: usize, spinning: bool) -> Result<f64, OnnxError> {
    let failed = |e: &dyn std::fmt::Display| OnnxError::Run(format!("a matrix product: {}", one_line(e)));
    let mut session = Session::builder(&library.environment)
        .map_err(|e| failed(&e))?
        .with_intra_threads(threads)
        .map_err(|e| failed(&e))?
        .with_intra_op_spinning(spinning)
        .map_err(|e| failed(&e))?
        .commit_from_memory(&product())
        .map_err(|e| failed(&e))?;
    let matrix = vec![0.5f32; SIDE * SIDE];
    let operand = || TensorRef::from_array_view(([SIDE, SIDE], matrix.as_slice()));
    let mut best = Duration::MAX;
    let begun = Instant::now();
    while begun.elapsed() < PERIOD {
        let (a, b) = (
            operand().map_err(|e| failed(&e))?,
            operand().map_err(|e| failed(&e))?,
        );
        let started = Instant::now();
        session.run(vec![("a", a), ("b", b)]).map_err(|e| failed(&e))?;
        best = best.min(started.elapsed());
    }
    Ok((SIDE as f64).powi(3) / best.as_secs_f64() / 1e9)
}

/// An ONNX model (as protocol buffers: `onnx.proto` of ONNX 1.16) of one operator: c = a · b.
fn product() -> Vec<u8> {
    let text = |field, text: &str| bytes(field, text.as_bytes());
    let dims = [SIDE; 2].map(|side| bytes(1, &number(1, side as u64))).concat();
    let matrix = bytes(1, &[number(1, 1), bytes(2, &dims)].concat());
    let value = |name| [text(1, name), bytes(2, &matrix)].concat();
    let node = [text(1, "a"), text(1, "b"), text(2, "c"), text(4, "MatMul")].concat();
    let graph = [
        bytes(1, &node),
        text(2, "product"),
        bytes(11, &value("a")),
        bytes(11, &value("b")),
        bytes(12, &value("c")),
    ];
    let (ir_version, opset) = (number(1, 9), number(2, 20));
    [ir_version, bytes(7, &graph.concat()), bytes(8, &opset)].concat()
}

/// A field of a protocol buffer that is a number.
fn number(field: u64, value: u64) -> Vec<u8> {
    [varint(field << 3), varint(value)].concat()
}

/// A field of a protocol buffer that has a length.
fn bytes(field: u64, value: &[u8]) -> Vec<u8> {
    [varint(field << 3 | 2), varint(value.len() as u64), value.to_vec()].concat()
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_seven_bits_at_a_time() {
        assert_eq!(varint(1), [1]);
        assert_eq!(varint(300), [0xac, 0x02]);
        assert_eq!(bytes(2, b"c"), [0x12, 1, b'c']);
    }

    #[test]
    fn this_machine_multiplies() {
        match Library::load(None) {
            Ok(library) => assert!(peak_gmacs(&library, 1, false).unwrap() > 0.0),
            Err(OnnxError::NoLibrary) => {
                println!("skipped: this_machine_multiplies: no library of ONNX Runtime")
            }
            Err(e) => panic!("{e}"),
        }
    }
}
