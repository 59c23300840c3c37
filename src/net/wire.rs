//! Messages between a program and the child process that holds a network: a head, its length before
//! it, then the bytes that the head announces.
//!
//! Each length is held against a limit before anything is allocated.

use std::io::{Error, ErrorKind, Read, Result, Write};
use std::path::PathBuf;

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{Backend, NetError, Port, Tensor};

/// The largest head, bytes.
const MAX_HEAD: usize = 1 << 20;
/// The most numbers in all tensors of one message: 1 GiB.
const MAX_NUMBERS: usize = 1 << 28;

/// The head of a request by the program.
#[derive(Serialize, Deserialize)]
pub enum Request {
    /// Load the network whose `bytes` follow.
    Load { backend: Backend, library: Option<PathBuf>, threads: usize, bytes: u64 },
    /// Compute these outputs from the inputs, by name and shape, whose numbers follow.
    Run { inputs: Vec<(String, Vec<usize>)>, outputs: Vec<String> },
}

/// The answer to [`Request::Load`]: inputs and outputs.
pub type LoadAnswer = std::result::Result<(Vec<Port>, Vec<Port>), NetError>;
/// The head of the answer to [`Request::Run`]: the shapes of the outputs, whose numbers follow.
pub type Computed = std::result::Result<Vec<Vec<usize>>, NetError>;

fn wrong(message: impl Into<String>) -> Error {
    Error::new(ErrorKind::InvalidData, message.into())
}

/// Writes a message head: its length in 8 bytes, then its postcard encoding.
///
/// # Errors
/// The head exceeds `MAX_HEAD` bytes, or writing fails.
pub fn write_head(out: &mut impl Write, head: &impl Serialize) -> Result<()> {
    let bytes = postcard::to_stdvec(head).map_err(|e| wrong(e.to_string()))?;
    if bytes.len() > MAX_HEAD {
        return Err(wrong(format!(
            "wanted a head of at most {MAX_HEAD} bytes, got {}",
            bytes.len()
        )));
    }
    out.write_all(&(bytes.len() as u64).to_le_bytes())?;
    out.write_all(&bytes)
}

/// Reads a message head that [`write_head`] wrote.
///
/// # Errors
/// The head exceeds `MAX_HEAD` bytes, is not of this type, or reading fails.
pub fn read_head<T: DeserializeOwned>(input: &mut impl Read) -> Result<T> {
    let mut length = [0; 8];
    input.read_exact(&mut length)?;
    let length = u64::from_le_bytes(length);
    let fits = usize::try_from(length).ok().filter(|length| *length <= MAX_HEAD);
    let mut bytes =
        vec![
            0;
            fits.ok_or_else(|| wrong(format!("wanted at most {MAX_HEAD} bytes, got {length}")))?
        ];
    input.read_exact(&mut bytes)?;
    postcard::from_bytes(&bytes).map_err(|e| wrong(e.to_string()))
}

/// Writes the numbers of a tensor in the byte order of the machine.
///
/// # Errors
/// Writing fails.
pub fn write_numbers(out: &mut impl Write, tensor: &Tensor) -> Result<()> {
    out.write_all(bytemuck::cast_slice(tensor.data()))
}

/// Reads tensors of these shapes, one after the other.
///
/// # Errors
/// The shapes exceed the limit of numbers, or reading fails.
pub fn read_tensors(input: &mut impl Read, shapes: &[Vec<usize>]) -> Result<Vec<Tensor>> {
    let mut left = MAX_NUMBERS;
    let tensor = |shape: &Vec<usize>| {
        let numbers = shape.iter().try_fold(1, |product: usize, n| product.checked_mul(*n));
        let numbers = numbers.filter(|numbers| *numbers <= left);
        let numbers = numbers
            .ok_or_else(|| wrong(format!("wanted at most {MAX_NUMBERS} numbers, got {shape:?}")))?;
        left -= numbers;
        let mut data = vec![0.0f32; numbers];
        input.read_exact(bytemuck::cast_slice_mut(&mut data))?;
        Ok(Tensor::new(shape, data))
    };
    shapes.iter().map(tensor).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_and_numbers_come_back() {
        let tensors = [
            Tensor::new(&[2, 1], vec![1.5, -0.0]),
            Tensor::new(&[0, 7], vec![]),
            Tensor::new(&[], vec![3.0]),
        ];
        let shapes: Computed = Ok(tensors.iter().map(|tensor| tensor.shape().to_vec()).collect());
        let mut bytes = Vec::new();
        write_head(&mut bytes, &shapes).expect("memory takes it");
        tensors
            .iter()
            .for_each(|tensor| write_numbers(&mut bytes, tensor).expect("memory takes it"));
        let mut input = &bytes[..];
        let head: Computed = read_head(&mut input).expect("it is whole");
        assert_eq!(head, shapes);
        assert_eq!(
            read_tensors(&mut input, &head.expect("it was computed")).expect("they are whole"),
            tensors
        );
        for cut in 0..bytes.len() {
            let mut input = &bytes[..cut];
            let whole = read_head::<Computed>(&mut input)
                .and_then(|head| read_tensors(&mut input, &head.expect("it was computed")));
            assert!(whole.is_err(), "{cut} of {} bytes", bytes.len());
        }
    }

    #[test]
    fn lengths_are_held_against_limits_before_anything_is_allocated() {
        for length in [MAX_HEAD as u64 + 1, u64::MAX] {
            assert!(
                read_head::<Computed>(&mut &[&length.to_le_bytes()[..], &[0; 99]].concat()[..])
                    .is_err()
            );
        }
        for shapes in
            [vec![vec![1 << 62]], vec![vec![usize::MAX, 3]], vec![vec![1 << 16], vec![MAX_NUMBERS]]]
        {
            let error =
                read_tensors(&mut std::io::repeat(0), &shapes).expect_err("they are too large");
            assert_eq!(error.kind(), ErrorKind::InvalidData, "{error}");
        }
        assert!(write_head(&mut Vec::new(), &"x".repeat(MAX_HEAD)).is_err());
    }
}
