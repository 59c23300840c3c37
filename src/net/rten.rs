//! The backend in pure Rust.

use std::sync::Arc;

use rten::{
    Dimension, Model, ModelOptions, NodeId, OpRegistry, RunOptions, ThreadPool, Value, op_registry,
};
use rten_tensor::AsView;
use rten_tensor::prelude::*;

use super::{NetError, Port, Tensor};

/// An operator of the file that rten computes otherwise than ONNX specifies, if there is one.
pub fn caution(bytes: &[u8]) -> Option<&'static str> {
    // The field `s` (4, a text of 5 bytes) of an attribute, as `mode` of Resize.
    let cubic = bytes.windows(7).any(|window| window == b"\x22\x05cubic");
    cubic.then_some(
        "it resizes by cubic interpolation, which rten replaces by linear: use --backend ort",
    )
}

/// Returns the operators of networks that take and return images, quantized ones included.
/// Recurrent cells, sequences and random numbers are left out: the linker drops their code, and a
/// hostile file cannot reach it.
fn operators() -> OpRegistry {
    op_registry!(
        Abs,
        Acos,
        Add,
        And,
        ArgMax,
        ArgMin,
        Asin,
        Atan,
        AveragePool,
        BatchNormalization,
        Cast,
        CastLike,
        Ceil,
        Clip,
        Concat,
        ConstantOfShape,
        Conv,
        ConvInteger,
        ConvTranspose,
        Cos,
        CumSum,
        DepthToSpace,
        DequantizeLinear,
        Div,
        DynamicQuantizeLinear,
        Einsum,
        Elu,
        Equal,
        Erf,
        Exp,
        Expand,
        Flatten,
        Floor,
        Gather,
        GatherElements,
        GatherND,
        Gelu,
        Gemm,
        GlobalAveragePool,
        Greater,
        GreaterOrEqual,
        GridSample,
        HardSigmoid,
        HardSwish,
        Identity,
        If,
        InstanceNormalization,
        IsInf,
        IsNaN,
        LayerNormalization,
        LeakyRelu,
        Less,
        LessOrEqual,
        Log,
        LogSoftmax,
        Loop,
        LpNormalization,
        MatMul,
        MatMulInteger,
        Max,
        MaxPool,
        Mean,
        Min,
        Mod,
        Mul,
        Neg,
        Not,
        Or,
        PRelu,
        Pad,
        Pow,
        QuantizeLinear,
        Range,
        Reciprocal,
        ReduceL2,
        ReduceMax,
        ReduceMean,
        ReduceMin,
        ReduceProd,
        ReduceSum,
        ReduceSumSquare,
        Relu,
        Reshape,
        Resize,
        Round,
        ScatterElements,
        ScatterND,
        Shape,
        Sigmoid,
        Sign,
        Sin,
        Size,
        Slice,
        Softmax,
        Softplus,
        Softsign,
        Split,
        Sqrt,
        Squeeze,
        Sub,
        Sum,
        Tan,
        Tanh,
        Tile,
        TopK,
        Transpose,
        Trilu,
        Unsqueeze,
        Upsample,
        Where,
        Xor
    )
}

pub struct RtenNetwork {
    model: Model,
    options: RunOptions,
}

impl RtenNetwork {
    /// Loads a network; returns its inputs and outputs, too.
    ///
    /// # Errors
    /// The bytes are not a network that rten can read.
    pub fn new(
        bytes: Vec<u8>,
        threads: usize,
    ) -> Result<(RtenNetwork, Vec<Port>, Vec<Port>), NetError> {
        // On a thread of its own: one of the engine's, waiting for rten's pool inside, could take
        // up a stage that waits for this network.
        let load = || ModelOptions::with_ops(operators()).load(bytes);
        let load = std::thread::scope(|scope| scope.spawn(load).join());
        let model = match load {
            Ok(model) => model.map_err(|e| NetError::Damaged(e.to_string()))?,
            Err(_) => return Err(NetError::Damaged("reading it panicked".into())),
        };
        let port = |&id: &NodeId| {
            let info = model.node_info(id);
            let size = |dimension: &Dimension| match dimension {
                Dimension::Fixed(n) => Some(*n),
                Dimension::Symbolic(_) => None,
            };
            Port {
                name: info.as_ref().and_then(|info| info.name()).unwrap_or_default().to_owned(),
                shape: info.and_then(|info| Some(info.shape()?.iter().map(size).collect())),
            }
        };
        let inputs = model.input_ids().iter().map(port).collect();
        let outputs = model.output_ids().iter().map(port).collect();
        let pool = Arc::new(ThreadPool::with_num_threads(threads));
        let options = RunOptions::default().with_thread_pool(Some(pool));
        Ok((RtenNetwork { model, options }, inputs, outputs))
    }

    /// Computes the outputs of these names, in their order.
    ///
    /// # Errors
    /// The inputs do not fit the network, or computing it fails.
    pub fn run(
        &self,
        inputs: Vec<(&str, Tensor)>,
        outputs: &[&str],
    ) -> Result<Vec<Tensor>, NetError> {
        let failed = |e: &dyn std::fmt::Display| NetError::Run(e.to_string());
        let id = |name: &str| self.model.node_id(name).map_err(|e| failed(&e));
        let mut values = Vec::new();
        for (name, tensor) in inputs {
            let shape = tensor.shape().to_vec();
            let value = rten_tensor::Tensor::from_data(&shape, tensor.into_data());
            values.push((id(name)?, Value::from(value).into()));
        }
        let wanted = outputs.iter().map(|name| id(name)).collect::<Result<Vec<_>, _>>()?;
        let got =
            self.model.run(values, &wanted, Some(self.options.clone())).map_err(|e| failed(&e))?;
        let taken = got.into_iter().map(|value| {
            let value: rten_tensor::Tensor<f32> = value.try_into().map_err(|e| failed(&e))?;
            Ok(Tensor::new(value.shape(), value.to_vec()))
        });
        taken.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_operator_that_is_left_out_is_named() {
        // A model of one node, `y = LSTM()`, in protocol buffers.
        let node = b"\x12\x01y\x22\x04LSTM";
        let graph = [b"\x0a\x09", &node[..], b"\x62\x03\x0a\x01y"].concat();
        let model = [b"\x08\x08\x42\x02\x10\x11\x3a\x10", &graph[..]].concat();
        let Err(NetError::Damaged(text)) = RtenNetwork::new(model, 1) else {
            panic!("it was loaded");
        };
        assert!(text.contains("LSTM operator not supported or not enabled"), "{text}");
    }
}
