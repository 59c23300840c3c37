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

    /// Whether all bits of all pixels are zero.
    pub fn is_zero(&self) -> bool
    where
        T: Pod,
    {
        is_zero(bytemuck::cast_slice(&self.data))
    }

    /// A plane whose pixel (x, y) is `value(x, y)`.
    pub fn from_fn(
        width: usize,
        height: usize,
        mut value: impl FnMut(usize, usize) -> T,
    ) -> Plane<T> {
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend((0..width).map(|x| value(x, y)));
        }
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

/// Bytes that are looked at together for zeros.
const BLOCK: usize = 4096;
/// Bytes of the largest plane that is read: three floats a pixel of the largest photo.
const MAX_BYTES: u128 = 1 << 30;

/// The form in which a plane is stored: width, height, and its bytes without the zeros, as runs of
/// zero bytes before and other bytes. Masks are mostly zero, and so are layers of lights that are
/// off; neither file nor memory holds their zeros.
impl<T: Pod> Serialize for Plane<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let bytes: &[u8] = bytemuck::cast_slice(&self.data);
        let runs: Vec<(u64, Bytes)> =
            runs(bytes).into_iter().map(|(zeros, run)| (zeros, Bytes(run))).collect();
        (self.width as u64, self.height as u64, runs).serialize(serializer)
    }
}

fn is_zero(bytes: &[u8]) -> bool {
    bytes.chunks(64).all(|piece| piece.iter().fold(0, |all, byte| all | byte) == 0)
}

/// The parts of `bytes` that are not zero, each with the number of zeros before it. Parts begin and
/// end at blocks.
fn runs(bytes: &[u8]) -> Vec<(u64, &[u8])> {
    let mut runs = Vec::new();
    let (mut end, mut start) = (0, None);
    let ends = bytes.chunks(BLOCK).enumerate().map(|(i, block)| (i * BLOCK, is_zero(block)));
    for (at, is_zero) in ends.chain([(bytes.len(), true)]) {
        match (start, is_zero) {
            (None, false) => start = Some(at),
            (Some(from), true) => {
                runs.push(((from - end) as u64, &bytes[from..at]));
                (end, start) = (at, None);
            }
            _ => {}
        }
    }
    runs
}

impl<'de, T: Pod> Deserialize<'de> for Plane<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Plane<T>, D::Error> {
        let (width, height, runs): (u64, u64, Vec<(u64, Bytes<'de>)>) =
            Deserialize::deserialize(deserializer)?;
        let bytes = u128::from(width) * u128::from(height) * size_of::<T>() as u128;
        let wrong = |what: String| {
            serde::de::Error::custom(format!("a plane of {width} x {height} holds {what}"))
        };
        if bytes > MAX_BYTES {
            return Err(wrong(format!("{bytes} bytes, wanted at most {MAX_BYTES}")));
        }
        let mut data: Vec<T> = bytemuck::zeroed_vec((width * height) as usize);
        let mut rest: &mut [u8] = bytemuck::cast_slice_mut(&mut data);
        for (zeros, Bytes(run)) in runs {
            let part =
                usize::try_from(zeros).ok().and_then(|zeros| rest.split_at_mut_checked(zeros));
            let part = part.and_then(|(_, part)| part.split_at_mut_checked(run.len()));
            let (part, behind) = part.ok_or_else(|| wrong(format!("{bytes} bytes, got more")))?;
            part.copy_from_slice(run);
            rest = behind;
        }
        Ok(Plane { width: width as usize, height: height as usize, data })
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

#[cfg(test)]
mod tests {
    use super::*;

    fn stored<T: Pod>(plane: &Plane<T>) -> Vec<u8> {
        postcard::to_stdvec(plane).expect("memory takes all bytes")
    }

    #[test]
    fn a_plane_is_stored_without_its_zeros() {
        let (w, h) = (301, 97);
        let at = |wanted: fn(usize) -> bool| {
            Plane::from_fn(w, h, |x, y| if wanted(y * w + x) { (x + 1) as f32 } else { 0.0 })
        };
        let planes: [(Plane<f32>, usize); 6] = [
            (at(|_| true), w * h * 4),
            (at(|_| false), 0),
            (at(|i| i == 0), BLOCK),
            (at(|i| i == 301 * 97 - 1), BLOCK),
            (at(|i| (5000..5100).contains(&i)), BLOCK),
            (at(|i| i % 2048 == 7), w * h * 4 / 2 + BLOCK),
        ];
        for (i, (plane, most)) in planes.iter().enumerate() {
            let bytes = stored(plane);
            assert!(bytes.len() <= most + 128, "plane {i}: {} bytes, wanted {most}", bytes.len());
            assert_eq!(postcard::from_bytes::<Plane<f32>>(&bytes).as_ref(), Ok(plane), "plane {i}");
        }
        let empty = Plane::<f32>::filled(0, 0, 0.0);
        assert_eq!(postcard::from_bytes(&stored(&empty)), Ok(empty));
        // Minus zero has a bit.
        let minus = postcard::from_bytes::<Plane<f32>>(&stored(&Plane::filled(3, 3, -0.0f32)));
        assert!(minus.expect("it is whole").pixels().iter().all(|v| v.is_sign_negative()));
    }

    #[test]
    fn a_stored_plane_whose_parts_do_not_fit_is_refused() {
        let read = |form: (u64, u64, Vec<(u64, &[u8])>)| {
            let bytes = postcard::to_stdvec(&form).expect("memory takes all bytes");
            postcard::from_bytes::<Plane<u16>>(&bytes)
        };
        assert!(read((2, 2, vec![(2, &[1, 0]), (2, &[3, 0])])).is_ok());
        for bad in [
            (2, 2, vec![(0, &[0u8; 9][..])]),
            (2, 2, vec![(9, &[][..])]),
            (2, 2, vec![(u64::MAX, &[1][..])]),
            (2, 2, vec![(4, &[1, 1]), (1, &[1, 1])]),
            (u64::MAX, u64::MAX, vec![]),
            (1 << 30, 1, vec![]),
        ] {
            assert!(read(bad.clone()).is_err(), "{bad:?}");
        }
    }
}
