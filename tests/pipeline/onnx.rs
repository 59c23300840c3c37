//! Tiny ONNX networks, written as the bytes of their protocol buffers: field numbers are those of
//! onnx.proto (github.com/onnx/onnx).

/// A network in the making: nodes in the order in which they are computed.
#[derive(Default)]
pub struct Onnx {
    graph: Vec<u8>,
}

/// A dimension that the file leaves open.
pub const OPEN: i64 = -1;

impl Onnx {
    pub fn input(self, name: &str, shape: &[i64]) -> Onnx {
        self.message(11, value_info(name, shape))
    }

    pub fn output(self, name: &str, shape: &[i64]) -> Onnx {
        self.message(12, value_info(name, shape))
    }

    /// A constant of 32-bit floats.
    pub fn floats(self, name: &str, shape: &[i64], values: &[f32]) -> Onnx {
        self.constant(name, 1, shape, values.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    /// A constant of whole numbers.
    pub fn numbers(self, name: &str, values: &[i64]) -> Onnx {
        self.constant(
            name,
            7,
            &[values.len() as i64],
            values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        )
    }

    pub fn node(self, operator: &str, inputs: &[&str], outputs: &[&str]) -> Onnx {
        self.node_with(operator, inputs, outputs, &[])
    }

    /// `output` = `input`, by a loop of 2^62 turns.
    pub fn endless(self, input: &str, output: &str) -> Onnx {
        let body = Onnx::default().node("Identity", &["on"], &["still_on"]).node(
            "Identity",
            &["v"],
            &["same"],
        );
        let body =
            ["turn", "on", "v"].iter().fold(body, |body, name| body.message(11, named(name)));
        let mut body = body.message(12, named("still_on")).message(12, named("same")).graph;
        bytes(&mut body, 2, b"body");
        let mut attribute = Vec::new();
        bytes(&mut attribute, 1, b"body");
        bytes(&mut attribute, 6, &body);
        number(&mut attribute, 20, 5);
        let turns = self.constant("turns", 7, &[], (1_i64 << 62).to_le_bytes().into()).constant(
            "yes",
            9,
            &[],
            vec![1],
        );
        turns.node_of("Loop", &["turns", "yes", input], &[output], &[attribute])
    }

    /// `output` = `input` at `scales` times its size, by cubic interpolation.
    pub fn cubic(self, input: &str, output: &str, scales: [f32; 4]) -> Onnx {
        let name = format!("{output}_scales");
        let mut attribute = Vec::new();
        bytes(&mut attribute, 1, b"mode");
        bytes(&mut attribute, 4, b"cubic");
        number(&mut attribute, 20, 3);
        self.floats(&name, &[4], &scales).node_of(
            "Resize",
            &[input, "", &name],
            &[output],
            &[attribute],
        )
    }

    /// A node with attributes that are lists of whole numbers.
    pub fn node_with(
        self,
        operator: &str,
        inputs: &[&str],
        outputs: &[&str],
        attributes: &[(&str, &[u64])],
    ) -> Onnx {
        let lists = attributes.iter().map(|(name, values)| {
            let mut attribute = Vec::new();
            bytes(&mut attribute, 1, name.as_bytes());
            values.iter().for_each(|&value| number(&mut attribute, 8, value));
            number(&mut attribute, 20, 7);
            attribute
        });
        self.node_of(operator, inputs, outputs, &lists.collect::<Vec<_>>())
    }

    fn node_of(
        self,
        operator: &str,
        inputs: &[&str],
        outputs: &[&str],
        attributes: &[Vec<u8>],
    ) -> Onnx {
        let mut node = Vec::new();
        inputs.iter().for_each(|name| bytes(&mut node, 1, name.as_bytes()));
        outputs.iter().for_each(|name| bytes(&mut node, 2, name.as_bytes()));
        bytes(&mut node, 4, operator.as_bytes());
        attributes.iter().for_each(|attribute| bytes(&mut node, 5, attribute));
        self.message(1, node)
    }

    /// `output` = `weights` x `input` + `bias`, pixel by pixel: one row of three weights and one
    /// bias per channel.
    pub fn mix(self, input: &str, output: &str, weights: &[[f32; 3]], bias: &[f32]) -> Onnx {
        let (w, b) = (format!("{output}_w"), format!("{output}_b"));
        let n = weights.len() as i64;
        let network = self.floats(&w, &[n, 3, 1, 1], weights.as_flattened()).floats(&b, &[n], bias);
        // Attributes that exporters write although they have default values, and that rten
        // requires.
        let attributes: [(&str, &[u64]); 3] =
            [("kernel_shape", &[1, 1]), ("strides", &[1, 1]), ("dilations", &[1, 1])];
        network.node_with("Conv", &[input, &w, &b], &[output], &attributes)
    }

    /// The file: opset 17.
    pub fn file(mut self) -> Vec<u8> {
        bytes(&mut self.graph, 2, b"g");
        let mut opset = Vec::new();
        bytes(&mut opset, 1, b"");
        number(&mut opset, 2, 17);
        let mut model = Vec::new();
        number(&mut model, 1, 8);
        bytes(&mut model, 7, &self.graph);
        bytes(&mut model, 8, &opset);
        model
    }

    pub fn constant(self, name: &str, kind: u64, shape: &[i64], raw: Vec<u8>) -> Onnx {
        let mut tensor = Vec::new();
        shape.iter().for_each(|&n| number(&mut tensor, 1, n as u64));
        number(&mut tensor, 2, kind);
        bytes(&mut tensor, 8, name.as_bytes());
        bytes(&mut tensor, 9, &raw);
        self.message(5, tensor)
    }

    pub fn message(mut self, field: u64, message: Vec<u8>) -> Onnx {
        bytes(&mut self.graph, field, &message);
        self
    }
}

/// An input or output of a subgraph, of any type.
fn named(name: &str) -> Vec<u8> {
    let mut info = Vec::new();
    bytes(&mut info, 1, name.as_bytes());
    info
}

fn value_info(name: &str, shape: &[i64]) -> Vec<u8> {
    let mut dimensions = Vec::new();
    for (i, &n) in shape.iter().enumerate() {
        let mut dimension = Vec::new();
        if n == OPEN {
            bytes(&mut dimension, 2, format!("{name}_{i}").as_bytes());
        } else {
            number(&mut dimension, 1, n as u64);
        }
        bytes(&mut dimensions, 1, &dimension);
    }
    let (mut tensor, mut kind, mut info) = (Vec::new(), Vec::new(), Vec::new());
    number(&mut tensor, 1, 1);
    bytes(&mut tensor, 2, &dimensions);
    bytes(&mut kind, 1, &tensor);
    bytes(&mut info, 1, name.as_bytes());
    bytes(&mut info, 2, &kind);
    info
}

pub fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

pub fn number(out: &mut Vec<u8>, field: u64, value: u64) {
    varint(out, field << 3);
    varint(out, value);
}

pub fn bytes(out: &mut Vec<u8>, field: u64, value: &[u8]) {
    varint(out, field << 3 | 2);
    varint(out, value.len() as u64);
    out.extend(value);
}
