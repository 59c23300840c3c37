//! Ranges of parameters: one declaration gives the check, the message and the entry of the
//! reference.

use std::collections::BTreeMap;
use std::ops::{Bound, RangeBounds};

/// A number that a range can bound.
pub trait Number: Copy + PartialOrd {
    /// Neither infinite nor NaN.
    fn finite(self) -> bool;
    /// The number as messages and the reference show it.
    fn text(self) -> String;
}

macro_rules! integers {
    ($($ty:ty)*) => { $( impl Number for $ty {
        fn finite(self) -> bool {
            true
        }
        fn text(self) -> String {
            self.to_string()
        }
    } )* };
}
integers! { i32 i64 u32 u64 usize }

macro_rules! floats {
    ($($ty:ty)*) => { $( impl Number for $ty {
        fn finite(self) -> bool {
            self.is_finite()
        }
        fn text(self) -> String {
            let is_short = !self.is_finite() || self == 0.0 || (1e-3..1e6).contains(&self.abs());
            if is_short { self.to_string() } else { format!("{self:e}") }
        }
    } )* };
}
floats! { f32 f64 }

/// A parameter type that a range can bound: one number, or several with the same bounds.
pub trait Ranged {
    /// The type of one number.
    type Number: Number;
    /// The first number that is not finite or lies outside `range`, as text; `None` when all lie
    /// inside.
    fn outside(&self, range: &impl RangeBounds<Self::Number>) -> Option<String>;
}

macro_rules! ranged {
    ($($ty:ty)*) => { $( impl Ranged for $ty {
        type Number = $ty;
        fn outside(&self, range: &impl RangeBounds<$ty>) -> Option<String> {
            (!(self.finite() && range.contains(self))).then(|| self.text())
        }
    } )* };
}
ranged! { i32 i64 u32 u64 usize f32 f64 }

impl<T: Ranged> Ranged for Option<T> {
    type Number = T::Number;
    fn outside(&self, range: &impl RangeBounds<T::Number>) -> Option<String> {
        self.as_ref().and_then(|value| value.outside(range))
    }
}

impl<T: Ranged, const N: usize> Ranged for [T; N] {
    type Number = T::Number;
    fn outside(&self, range: &impl RangeBounds<T::Number>) -> Option<String> {
        self.iter().find_map(|value| value.outside(range))
    }
}

impl<T: Ranged> Ranged for BTreeMap<String, T> {
    type Number = T::Number;
    fn outside(&self, range: &impl RangeBounds<T::Number>) -> Option<String> {
        self.iter()
            .find_map(|(key, value)| value.outside(range).map(|got| format!("{got} for {key:?}")))
    }
}

/// The range of all numbers greater than `low`, for which Rust has no literal.
pub fn above<T>(low: T) -> (Bound<T>, Bound<T>) {
    (Bound::Excluded(low), Bound::Unbounded)
}

/// The range of a parameter of type `T` as messages and the reference show it: `0..=1`, `0..1`,
/// `> 0`.
pub fn range_text<T: Ranged>(range: &impl RangeBounds<T::Number>) -> String {
    use Bound::{Excluded, Included, Unbounded};
    let low = match (range.start_bound(), range.end_bound()) {
        (Included(low), Included(high)) => return format!("{}..={}", low.text(), high.text()),
        (Included(low), Excluded(high)) => return format!("{}..{}", low.text(), high.text()),
        (Included(low), Unbounded) => return format!(">= {}", low.text()),
        (Excluded(low), Unbounded) => return format!("> {}", low.text()),
        (Unbounded, Unbounded) => return "any finite number".to_owned(),
        (Excluded(low), _) => format!("> {} and ", low.text()),
        (Unbounded, _) => String::new(),
    };
    match range.end_bound() {
        Included(high) => format!("{low}<= {}", high.text()),
        Excluded(high) => format!("{low}< {}", high.text()),
        Unbounded => low,
    }
}

/// Checks that every number of `value` is finite and lies in `range`.
///
/// # Errors
/// `name: wanted 0..=1, got 1.5`.
///
/// ```
/// use relight::graph::{above, check_range};
/// assert_eq!(check_range("half", &[0.1, 0.2], above(0.0)), Ok(()));
/// assert_eq!(check_range("min_gain", &1.5, 0.0..=1.0), Err("min_gain: wanted 0..=1, got 1.5".into()));
/// ```
pub fn check_range<T: Ranged>(
    name: &str,
    value: &T,
    range: impl RangeBounds<T::Number>,
) -> Result<(), String> {
    match value.outside(&range) {
        Some(got) => Err(format!("{name}: wanted {}, got {got}", range_text::<T>(&range))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Bound::{Excluded, Included, Unbounded};

    #[test]
    fn bounds_include_what_they_show() {
        for (value, sound) in
            [(0.0, true), (1.0, false), (0.999, true), (-0.1, false), (f32::NAN, false)]
        {
            assert_eq!(check_range("x", &value, 0.0..1.0).is_ok(), sound, "{value} in 0..1");
        }
        assert_eq!(check_range("x", &1.0, 0.0..=1.0), Ok(()));
        assert_eq!(check_range("x", &0, 0..), Ok(()));
        assert_eq!(check_range("x", &0.0, above(0.0)), Err("x: wanted > 0, got 0".into()));
        let span = (Excluded(1.0), Included(1000.0));
        assert_eq!(check_range("x", &1.0, span), Err("x: wanted > 1 and <= 1000, got 1".into()));
        assert_eq!(check_range("x", &1000.0, span), Ok(()));
    }

    #[test]
    fn no_range_holds_a_number_that_is_not_finite() {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(check_range("x", &value, 0.0..).is_err(), "{value}");
            assert!(check_range("x", &value, ..).is_err(), "{value}");
            assert!(check_range("x", &value, ..=f64::INFINITY).is_err(), "{value}");
        }
    }

    #[test]
    fn groups_are_checked_by_component() {
        assert_eq!(check_range("x", &None::<f32>, 0.0..=1.0), Ok(()));
        assert_eq!(check_range("x", &Some(2), 0..=1), Err("x: wanted 0..=1, got 2".into()));
        assert_eq!(
            check_range("x", &[0.5, -2.0, 3.0], 0.0..=1.0),
            Err("x: wanted 0..=1, got -2".into())
        );
        let map = BTreeMap::from([("a".to_owned(), [0.0, 1.0]), ("b".to_owned(), [0.0, -1.0])]);
        assert_eq!(check_range("x", &map, 0.0..), Err("x: wanted >= 0, got -1 for \"b\"".into()));
    }

    #[test]
    fn texts_are_short() {
        assert_eq!(range_text::<f32>(&(1e-4..=1e7)), "1e-4..=1e7");
        assert_eq!(range_text::<f32>(&(0.001..=1000.0)), "0.001..=1000");
        assert_eq!(range_text::<u32>(&(1..=10_000_000)), "1..=10000000");
        assert_eq!(range_text::<f32>(&(Excluded(1.0), Excluded(2.0))), "> 1 and < 2");
        assert_eq!(range_text::<f32>(&(Unbounded, Included(2.0))), "<= 2");
        assert_eq!(range_text::<i64>(&(..5)), "< 5");
        assert_eq!(range_text::<i64>(&..), "any finite number");
    }
}
