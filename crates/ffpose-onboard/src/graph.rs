//! That a model needs no other file: ONNX's graphs can name files that hold their weights, which no checksum covers.

use crate::error::{Error, Result};
use crate::records::records;

/// Protobuf's own limit for messages within messages.
const MAX_DEPTH: usize = 100;

/// Fields of a tensor.
const TENSOR_NAME: u64 = 8;
const EXTERNAL_DATA: u64 = 13;

/// The messages of ONNX that hold tensors.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Message {
    Model,
    TrainingInfo,
    Graph,
    Node,
    Attribute,
    Function,
    SparseTensor,
    Tensor,
}

use Message::{Attribute, Function, Graph, Model, Node, SparseTensor, Tensor, TrainingInfo};

impl Message {
    /// Returns number and kind of the fields that are such messages (onnx.proto).
    fn fields(self) -> &'static [(u64, Self)] {
        match self {
            Model => &[(7, Graph), (20, TrainingInfo), (25, Function)],
            TrainingInfo => &[(1, Graph), (2, Graph)],
            Graph => &[(1, Node), (5, Tensor), (15, SparseTensor)],
            Node => &[(5, Attribute)],
            Attribute => &[
                (5, Tensor),
                (6, Graph),
                (10, Tensor),
                (11, Graph),
                (22, SparseTensor),
                (23, SparseTensor),
            ],
            Function => &[(7, Node), (11, Attribute)],
            SparseTensor => &[(1, Tensor), (2, Tensor)],
            Tensor => &[],
        }
    }
}

/// Refuses a model whose weights are not all in its own bytes.
///
/// # Errors
/// A tensor is in another file; or the bytes are no such message, or have too many within each other.
pub fn expect_self_contained(model: &[u8]) -> Result<()> {
    search(model, Model, 0)
}

fn search(message: &[u8], kind: Message, depth: usize) -> Result<()> {
    if depth > MAX_DEPTH {
        return Err(Error::new(format!(
            "expected at most {MAX_DEPTH} messages within each other, got more"
        )));
    }
    for record in records(message) {
        let (number, part) = record?;
        if let Some((_, kind)) = kind.fields().iter().find(|(field, _)| *field == number) {
            search(part, *kind, depth + 1)?;
        } else if kind == Tensor && number == EXTERNAL_DATA {
            let name = text(message, TENSOR_NAME)?;
            let (key, value) = (text(part, 1)?, text(part, 2)?);
            return Err(Error::new(format!(
                "expected all weights in this file, whose bytes are checked, got tensor {name} with external data \
                 ({key}: {value})"
            )));
        }
    }
    Ok(())
}

fn text(message: &[u8], number: u64) -> Result<String> {
    let fields = records(message).collect::<Result<Vec<_>>>()?;
    let found = fields.into_iter().find(|(field, _)| *field == number);
    Ok(String::from_utf8_lossy(found.map_or(&[], |(_, bytes)| bytes)).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A record below 128 bytes.
    fn record(number: u64, content: &[u8]) -> Vec<u8> {
        let mut record = Vec::new();
        let mut key = number << 3 | 2;
        while key >= 0x80 {
            record.push(u8::try_from(key & 0x7f).unwrap() | 0x80);
            key >>= 7;
        }
        record.extend([u8::try_from(key).unwrap(), u8::try_from(content.len()).unwrap()]);
        record.extend(content);
        record
    }

    /// A message within others, the innermost first.
    fn within(message: &[u8], numbers: &[u64]) -> Vec<u8> {
        numbers.iter().fold(message.to_vec(), |message, &number| record(number, &message))
    }

    #[test]
    fn weights_of_other_files_are_found_wherever_tensors_may_be() {
        let entry = [record(1, b"location"), record(2, b"w.bin")].concat();
        let tensor = [record(8, b"w"), record(13, &entry)].concat();
        for path in [
            &[5, 7][..],             // an initializer
            &[1, 15, 7],             // the values of a sparse one
            &[2, 15, 7],             // its indices
            &[5, 5, 1, 7],           // a constant
            &[10, 5, 1, 7],          // several
            &[1, 22, 5, 1, 7],       // a sparse constant
            &[1, 23, 5, 1, 7],       // several
            &[5, 6, 5, 1, 7],        // an initializer of a branch
            &[5, 5, 1, 11, 5, 1, 7], // a constant of one of several
            &[5, 5, 7, 25],          // a constant of a function
            &[5, 11, 25],            // the default of its attribute
            &[5, 1, 20],             // training's start
            &[5, 2, 20],             // and its step
        ] {
            let error = expect_self_contained(&within(&tensor, path)).unwrap_err().to_string();
            let expected = "got tensor w with external data (location: w.bin)";
            assert!(error.contains(expected), "{path:?}: {error}");
            let inside = [record(8, b"w"), record(9, &entry)].concat(); // raw data
            expect_self_contained(&within(&inside, path)).unwrap();
        }
    }

    #[test]
    fn depth_is_bounded_and_damage_told() {
        let mut graph = Vec::new();
        for _ in 0..6 {
            graph = within(&graph, &[6, 5, 1]); // a graph, of an attribute, of a node
        }
        expect_self_contained(&record(7, &graph)).unwrap();
        let error = search(&record(7, &graph), Model, MAX_DEPTH - 9).unwrap_err().to_string();
        assert!(error.contains("at most 100 messages within each other"), "{error}");
        assert!(expect_self_contained(&record(7, b"\x0a\x05ab")).is_err());
    }
}
