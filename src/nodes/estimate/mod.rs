//! From the seen room to materials and lights.

pub mod find_lights;
pub mod fit_lights;
pub mod init_lights;
pub mod paint;
pub mod retinex_materials;
