//! From the seen room to materials and lights.

pub mod retinex_materials;
