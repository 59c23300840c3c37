//! A row-major picture plane of any pixel type.

use bytemuck::Pod;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A row-major plane of `width` x `height` pixels; row 0 is the top of the picture.
///
/// ```
/// use relight::image::Plane;
///
/// let ramp = Plane::from_fn(4, 2, |x, _| x as f32);
/// assert_eq!(ramp.size(), (4, 2));
/// assert_eq!(ramp.get(3, 1), 3.0);
/// assert_eq!(ramp.map(|v| 2.0 * v).pixels()[1], 2.0);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Plane<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

impl<T: Copy> Plane<T> {
    /// A plane of one value.
    pub fn filled(width: usize, height: usize, value: T) -> Plane<T> {
        Plane { width, height, data: vec![value; width * height] }
    }

    /// A plane over `data`, which holds `width * height` pixels, row by row.
    ///
    /// # Panics
    /// `data` has another length.
    pub fn new(width: usize, height: usize, data: Vec<T>) -> Plane<T> {
        assert_eq!(data.len(), width * height, "a plane holds width x height pixels");
        Plane { width, height, data }
    }

    /// A plane whose pixel `i`, row by row, is `value(i)`. Zeros are not written: where the system
    /// gives out memory as zeros, a part of the plane that is all zero takes none.
    pub fn sparse(width: usize, height: usize, mut value: impl FnMut(usize) -> T) -> Plane<T>
    where
        T: Pod,
    {
        let mut data = vec![T::zeroed(); width * height];
        for (i, pixel) in data.iter_mut().enumerate() {
            let value = value(i);
            if bytemuck::bytes_of(&value).iter().any(|&byte| byte != 0) {
                *pixel = value;
            }
        }
        Plane { width, height, data }
    }

    /// A plane whose pixel (x, y) is `value(x, y)`.
    pub fn from_fn(
        width: usize,
        height: usize,
        mut value: impl FnMut(usize, usize) -> T,
    ) -> Plane<T> {
        let data = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| value(x, y))
            .collect();
        Plane { width, height, data }
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// (width, height)
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.data.len()
    }

    /// The plane does not have pixels.
    pub fn is_empty(&self) -> bool {
        self.data.is_empty()
    }

    /// The pixel in column `x` of row `y`.
    ///
    /// # Panics
    /// The index `y * width + x` is outside the plane.
    pub fn get(&self, x: usize, y: usize) -> T {
        self.data[y * self.width + x]
    }

    /// Sets the pixel in column `x` of row `y`.
    ///
    /// # Panics
    /// As [`Plane::get`].
    pub fn set(&mut self, x: usize, y: usize, value: T) {
        self.data[y * self.width + x] = value;
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[T] {
        &self.data
    }

    /// All pixels, row by row.
    pub fn pixels_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// All pixels, row by row.
    pub fn into_pixels(self) -> Vec<T> {
        self.data
    }

    /// The plane of `f` of each pixel, taken row by row.
    pub fn map<U: Copy>(&self, f: impl FnMut(T) -> U) -> Plane<U> {
        Plane {
            width: self.width,
            height: self.height,
            data: self.data.iter().copied().map(f).collect(),
        }
    }

    /// Memory held by the pixels, in bytes.
    pub fn bytes(&self) -> usize {
        self.data.len() * size_of::<T>()
    }
}

impl<T: Pod> Serialize for Plane<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (self.width as u64, self.height as u64, Bytes(bytemuck::cast_slice(&self.data)))
            .serialize(serializer)
    }
}

impl<'de, T: Pod> Deserialize<'de> for Plane<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Plane<T>, D::Error> {
        let (width, height, Bytes(bytes)): (u64, u64, Bytes<'de>) =
            Deserialize::deserialize(deserializer)?;
        let wanted = (width as u128) * (height as u128) * (size_of::<T>() as u128);
        if wanted != bytes.len() as u128 {
            return Err(serde::de::Error::custom(format!(
                "a plane of {width} x {height} holds {wanted} bytes, got {}",
                bytes.len()
            )));
        }
        Ok(Plane {
            width: width as usize,
            height: height as usize,
            data: bytemuck::pod_collect_to_vec(bytes),
        })
    }
}

/// Bytes as one byte string of serde, so that encoding is a copy and no loop over numbers.
pub struct Bytes<'a>(pub &'a [u8]);

impl Serialize for Bytes<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(self.0)
    }
}

impl<'de> Deserialize<'de> for Bytes<'de> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Bytes<'de>, D::Error> {
        <&'de [u8]>::deserialize(deserializer).map(Bytes)
    }
}
