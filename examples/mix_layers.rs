//! Mixes the light layers of a finished run anew: no graph, no cache, milliseconds.
//!
//! ```text
//! cargo run --release -- run graphs/demo.ron edits/none.ron
//! cargo run --release --example mix_layers -- out/picture.exr window_0=0.25 lamp_0=2 mixed
//! ```

use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;

use relight::graph::{Context, File, Node};
use relight::nodes::output::mix_layers::{MixLayers, MixLayersIn};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [layers, weights @ .., folder] = &arguments[..] else {
        return Err("wanted PICTURE.exr [LIGHT=WEIGHT ...] FOLDER".into());
    };
    let mut by_light = BTreeMap::new();
    for text in weights {
        let (light, weight) = text.split_once('=').ok_or("wanted LIGHT=WEIGHT")?;
        by_light.insert(light.to_owned(), [weight.parse::<f32>()?; 3]);
    }

    // A stage is a plain function of its parameters and inputs: this one reads a file and needs no
    // engine.
    let stage = MixLayers { layers: File::new(layers), weights: by_light, ..MixLayers::default() };
    let mixed = stage.run(MixLayersIn {}, &Context::default())?;
    std::fs::create_dir_all(folder)?;
    for (name, bytes) in &mixed.files.0 {
        std::fs::write(Path::new(folder).join(name), bytes)?;
    }
    Ok(())
}
