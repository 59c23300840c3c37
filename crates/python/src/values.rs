//! Outputs of nodes as NumPy arrays without a copy, and as plain Python values.

use std::any::Any;
use std::sync::Arc;

use bytemuck::Pod;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};
use relight::graph::{Artifact, PortValue, Value};
use relight::image::{
    Albedo, Depth, Layer, Mask, Normal, Picture, Plane, Points, Roughness, Shading, Specular,
};
use relight::nodes::artifacts::{
    Files, LayerError, Radiance, Scores, UnitDirect, UnitIndirect, Visibility,
};
use relight::{geometry, optics};

/// A plane of pixels that NumPy reads where it is, by its array interface.
#[pyclass(frozen, module = "relight")]
pub struct Buffer {
    /// Keeps the pixels alive, and as they are: nothing changes a value of the engine.
    _owner: Arc<dyn Any + Send + Sync>,
    address: usize,
    shape: Vec<usize>,
    form: &'static str,
}

#[pymethods]
impl Buffer {
    /// Version 3 of NumPy's protocol; the flag beside the address makes the array read-only.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", pyo3::types::PyTuple::new(py, &self.shape)?)?;
        interface.set_item("typestr", self.form)?;
        interface.set_item("data", (self.address, true))?;
        Ok(interface)
    }
}

/// Single precision, in the order of the machine.
const SINGLE: &str = if cfg!(target_endian = "little") { "<f4" } else { ">f4" };
/// Half precision.
const HALF: &str = if cfg!(target_endian = "little") { "<f2" } else { ">f2" };

/// The array of shape (height, width) or (height, width, channels) over a plane of `owner`.
fn array<'py, T: Pod, O: Any + Send + Sync>(
    py: Python<'py>,
    owner: &Arc<O>,
    plane: &Plane<T>,
    form: &'static str,
) -> PyResult<Bound<'py, PyAny>> {
    let (width, height) = plane.size();
    let channel = if form == HALF { 2 } else { 4 };
    let channels = size_of::<T>() / channel;
    let mut shape = vec![height, width];
    if channels > 1 {
        shape.push(channels);
    }
    let buffer =
        Buffer { _owner: owner.clone(), address: plane.pixels().as_ptr() as usize, shape, form };
    py.import("numpy")?.call_method1("asarray", (Bound::new(py, buffer)?,))
}

/// One plane of single precision.
fn single<'py, T: Pod, O: Any + Send + Sync>(
    py: Python<'py>,
    owner: &Arc<O>,
    plane: &Plane<T>,
) -> PyResult<Bound<'py, PyAny>> {
    array(py, owner, plane, SINGLE)
}

/// A list of planes, one per lobe.
fn singles<'py, 'a, T: Pod, O: Any + Send + Sync>(
    py: Python<'py>,
    owner: &Arc<O>,
    planes: impl IntoIterator<Item = &'a Plane<T>>,
) -> PyResult<Bound<'py, PyList>> {
    let arrays: PyResult<Vec<_>> =
        planes.into_iter().map(|plane| single(py, owner, plane)).collect();
    PyList::new(py, arrays?)
}

/// A small value by way of JSON.
fn plain<'py, T: serde::Serialize>(py: Python<'py>, value: &T) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(|e| PyTypeError::new_err(e.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}

/// The output of a port: a value, a dictionary by member, or `None`.
///
/// # Errors
/// The value has a type without a form in Python.
pub fn of_port<'py>(py: Python<'py>, port: &PortValue) -> PyResult<Bound<'py, PyAny>> {
    match port {
        PortValue::One(value) => of_value(py, value),
        PortValue::Missing => Ok(py.None().into_bound(py)),
        PortValue::Many(members) => {
            let values = PyDict::new(py);
            for (member, value) in members {
                values.set_item(member, of_value(py, value)?)?;
            }
            Ok(values.into_any())
        }
    }
}

fn of_value<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    macro_rules! first {
        ($( $ty:ty: $convert:expr ),* $(,)?) => {$(
            if let Some(value) = value.get::<$ty>() {
                let convert: fn(Python<'py>, &Arc<$ty>) -> PyResult<Bound<'py, PyAny>> = $convert;
                return convert(py, &value);
            }
        )*};
    }
    first! {
        Picture: |py, v| single(py, v, &v.0),
        Layer: layer,
        Albedo: |py, v| single(py, v, &v.0),
        Normal: |py, v| single(py, v, &v.0),
        Points: |py, v| single(py, v, &v.0),
        Depth: |py, v| single(py, v, &v.0),
        Roughness: |py, v| single(py, v, &v.0),
        Specular: |py, v| single(py, v, &v.0),
        Shading: |py, v| single(py, v, &v.0),
        Mask: |py, v| single(py, v, &v.0),
        LayerError: |py, v| single(py, v, &v.stderr),
        UnitDirect: |py, v| fields(py, [
            ("lobes", singles(py, v, &v.lobes)?), ("stderr", singles(py, v, &v.stderr)?),
        ]),
        Visibility: |py, v| fields(py, [
            ("lit", singles(py, v, &v.lit)?), ("stderr", singles(py, v, &v.stderr)?),
            ("unknown", singles(py, v, &v.unknown)?),
        ]),
        UnitIndirect: |py, v| fields(py, [
            ("lobes", singles(py, v, v.lobes.iter().map(|lobe| &lobe.0))?),
            ("stderr", singles(py, v, &v.stderr)?),
        ]),
        Files: files,
        Radiance: |py, v| plain(py, &**v),
        Scores: |py, v| plain(py, &**v),
        optics::Shape: |py, v| plain(py, &**v),
        geometry::Camera: |py, v| plain(py, &**v),
        geometry::RoomLayout: |py, v| plain(py, &**v),
    }
    let wanted = [Picture::TYPE, Layer::TYPE, Depth::TYPE, UnitDirect::TYPE, Files::TYPE];
    Err(PyTypeError::new_err(format!(
        "a value of type {} has no form in Python: wanted a plane, layers or files, such as {}",
        value.type_name(),
        wanted.join(", ")
    )))
}

fn layer<'py>(py: Python<'py>, layer: &Arc<Layer>) -> PyResult<Bound<'py, PyAny>> {
    match &**layer {
        Layer::Half(plane) => array(py, layer, plane, HALF),
        Layer::Float(plane) => single(py, layer, plane),
    }
}

fn files<'py>(py: Python<'py>, files: &Arc<Files>) -> PyResult<Bound<'py, PyAny>> {
    let contents = PyDict::new(py);
    for (name, bytes) in &files.0 {
        contents.set_item(name, PyBytes::new(py, bytes))?;
    }
    Ok(contents.into_any())
}

fn fields<'py, const N: usize>(
    py: Python<'py>,
    fields: [(&str, Bound<'py, PyList>); N],
) -> PyResult<Bound<'py, PyAny>> {
    let values = PyDict::new(py);
    for (name, planes) in fields {
        values.set_item(name, planes)?;
    }
    Ok(values.into_any())
}
