//! From the seen room to materials and lights.

pub mod depth;
pub mod find_lights;
pub mod fit_lights;
pub mod init_lights;
pub mod inv_lamp_net;
pub mod inv_win_net;
pub mod mnet;
pub mod onnx_materials;
pub mod paint;
pub mod refine_lights;
pub mod remains;
pub mod retinex_materials;
pub mod vis_lamp_net;
pub mod vis_win_net;
