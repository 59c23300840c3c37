//! Tensors: inputs and outputs of networks.

/// 32-bit numbers in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    shape: Vec<usize>,
    data: Vec<f32>,
}

impl Tensor {
    /// A tensor over `data`, whose length is the product of `shape`.
    ///
    /// # Panics
    /// The length of `data` is not the product of `shape`.
    pub fn new(shape: &[usize], data: Vec<f32>) -> Tensor {
        assert_eq!(
            data.len(),
            shape.iter().product::<usize>(),
            "a tensor holds as many numbers as its shape says"
        );
        Tensor { shape: shape.to_vec(), data }
    }

    /// Returns the sizes of the axes, outermost first.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Returns the numbers, the last axis fastest.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// Returns the numbers, the last axis fastest, without a copy.
    pub fn into_data(self) -> Vec<f32> {
        self.data
    }
}
