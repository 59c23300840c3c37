//! The networks in models/: each file is the one that its card describes, and gives the same
//! outputs as in training (docs: training/README.md).

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use npyz::NpyFile;
use rten::{Model, Value};
use rten_tensor::prelude::*;
use rten_tensor::{SliceItem, Tensor};
use sha2::{Digest, Sha256};

/// Largest difference from the training framework, as a share of the largest output.
const PARITY: f32 = 1e-4;

/// The parity files hold each such row and column of output pictures.
const SPARSE: isize = 4;

const NETWORKS: [&str; 8] = [
    "indirectnet",
    "invlampnet",
    "invwinnet",
    "lightnet",
    "mnet",
    "shadownet",
    "vislampnet",
    "viswinnet",
];

fn file(folder: &str, name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(folder).join(name)
}

/// An input or output of the training framework, 16 or 32 bits. The name of a shared input does not
/// contain a network.
fn array(network: &str, name: &str) -> Result<Tensor<f32>, Box<dyn Error>> {
    let own = file("tests/parity", &format!("{network}.{name}.npy"));
    let bytes =
        fs::read(if own.exists() { own } else { file("tests/parity", &format!("{name}.npy")) })?;
    let npy = NpyFile::new(&bytes[..])?;
    let shape: Vec<usize> = npy.shape().iter().map(|&n| n as usize).collect();
    let values: Vec<f32> = if npy.dtype().descr().contains("f2") {
        npy.into_vec::<half::f16>()?.into_iter().map(f32::from).collect()
    } else {
        npy.into_vec()?
    };
    Ok(Tensor::from_data(&shape, values))
}

#[test]
fn each_network_gives_what_it_gave_in_training() -> Result<(), Box<dyn Error>> {
    for network in NETWORKS {
        let model = Model::load_file(file("models", &format!("{network}.onnx")))?;
        let name = |id| -> Result<String, Box<dyn Error>> {
            Ok(model
                .node_info(id)
                .and_then(|node| node.name().map(String::from))
                .ok_or("a nameless node")?)
        };
        let mut inputs = Vec::new();
        for &id in model.input_ids() {
            inputs.push((id, Value::from(array(network, &name(id)?)?).into()));
        }
        let outputs = model.run(inputs, model.output_ids(), None)?;
        assert_eq!(outputs.len(), model.output_ids().len());
        for (&id, output) in model.output_ids().iter().zip(outputs) {
            let name = name(id)?;
            let (got, want): (Tensor<f32>, _) = (output.try_into()?, array(network, &name)?);
            let each = |axis| {
                SliceItem::range(0, None, if axis > 1 && got.ndim() == 4 { SPARSE } else { 1 })
            };
            let got = got.slice((0..got.ndim()).map(each).collect::<Vec<_>>().as_slice());
            assert_eq!(got.shape(), want.shape(), "{network}: {name}");
            let largest = want.iter().fold(0.0_f32, |top, x| top.max(x.abs()));
            let worst =
                got.iter().zip(want.iter()).fold(0.0_f32, |worst, (a, b)| worst.max((a - b).abs()));
            assert!(worst <= PARITY * largest, "{network}: {name} is off by {worst} of {largest}");
        }
    }
    Ok(())
}

#[test]
fn each_card_names_the_digest_of_its_network() -> Result<(), Box<dyn Error>> {
    for network in NETWORKS {
        let digest = Sha256::digest(fs::read(file("models", &format!("{network}.onnx")))?);
        let hex: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
        let card = fs::read_to_string(file("models", &format!("{network}.md")))?;
        assert!(card.contains(&hex), "models/{network}.md does not name {hex}");
    }
    Ok(())
}

#[test]
fn all_models_together_are_small() -> Result<(), Box<dyn Error>> {
    let mut bytes = 0;
    for entry in fs::read_dir(file("models", ""))? {
        bytes += entry?.metadata()?.len();
    }
    assert!(bytes <= 20_000_000, "{bytes} bytes");
    Ok(())
}
