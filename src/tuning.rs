//! Tuning constants: the numbers that decide an algorithm, with their units, sources and effects.
//!
//! Each algorithm declares one table with `tuning!`, and each room lists the tables of its
//! algorithms in a function `tuning` in its `mod.rs`. `relight nodes --tuning` writes all of them,
//! from which docs/tuning.md is made.
//!
//! ```text
//! tuning! {
//!     /// Constants of the search for lamps.
//!     pub const SEARCH: SearchTuning {
//!         /// Least fraction of the loss that a lamp must save.
//!         min_gain: f64 = 0.05,
//!             unit "fraction", source Measured("docs/estimation.md"), effect "a larger value keeps fewer lamps";
//!     }
//! }
//! ```
//!
//! The code reads `SEARCH.min_gain`. Another `SearchTuning` can stand in its place in a test.

/// Origin of a constant's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Provenance {
    /// A publication or a standard.
    Paper(&'static str),
    /// A measurement of this project, with the page, test or data that shows it.
    Measured(&'static str),
    /// A consequence of other constants, of number formats or of definitions.
    Derived(&'static str),
    /// A choice by eye, which nothing has measured.
    Taste,
}

impl std::fmt::Display for Provenance {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Provenance::Paper(detail) => write!(f, "paper ({detail})"),
            Provenance::Measured(detail) => write!(f, "measured ({detail})"),
            Provenance::Derived(detail) => write!(f, "derived ({detail})"),
            Provenance::Taste => f.write_str("taste"),
        }
    }
}

/// One constant of a [`Table`].
#[derive(Clone, Debug)]
pub struct Constant {
    /// Name of the field.
    pub name: &'static str,
    /// The value as Rust writes it.
    pub value: String,
    /// Documentation of the field.
    pub doc: &'static str,
    /// Unit of the value.
    pub unit: &'static str,
    /// Origin of the value.
    pub source: Provenance,
    /// The consequence of another value.
    pub effect: &'static str,
}

/// The constants of one algorithm; made by `tuning!`.
#[derive(Clone, Debug)]
pub struct Table {
    /// Name of the struct.
    pub name: &'static str,
    /// The file that declares it, as the compiler names it.
    pub file: &'static str,
    /// Documentation of the struct.
    pub doc: &'static str,
    /// Constants, in the order of declaration.
    pub constants: Vec<Constant>,
}

/// Declares the constants of one algorithm: a struct, its only value, and its [`Table`]; the
/// module's documentation has the form.
macro_rules! tuning {
    ($(#[doc = $doc:literal])+ $vis:vis const $value:ident: $name:ident {
        $( $(#[doc = $field_doc:literal])+ $field:ident: $ty:ty = $number:expr,
            unit $unit:literal, source $source:ident $(($detail:literal))?, effect $effect:literal; )+
    }) => {
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug)]
        $vis struct $name { $(
            $(#[doc = $field_doc])+
            #[doc = concat!(
                "\n\nUnit: ", $unit, ". Source: ", stringify!($source $(($detail))?), ". Effect: ", $effect, "."
            )]
            $vis $field: $ty,
        )+ }

        $(#[doc = $doc])+
        $vis const $value: $name = $name { $( $field: $number ),+ };

        impl $name {
            /// The constants as docs/tuning.md shows them.
            $vis fn table() -> $crate::tuning::Table {
                $crate::tuning::Table {
                    name: stringify!($name),
                    file: file!(),
                    doc: concat!($($doc, "\n",)+ ""),
                    constants: vec![$( $crate::tuning::Constant {
                        name: stringify!($field),
                        value: format!("{:?}", $value.$field),
                        doc: concat!($($field_doc, "\n",)+ ""),
                        unit: $unit,
                        source: $crate::tuning::Provenance::$source $(($detail))?,
                        effect: $effect,
                    } ),+],
                }
            }
        }
    };
}
pub(crate) use tuning;

#[cfg(test)]
mod tests {
    tuning! {
        /// Constants of a test.
        const TEST: TestTuning {
            /// Least gain.
            min_gain: f64 = 0.05, unit "fraction", source Measured("here"), effect "a larger value keeps less";
            /// Sizes.
            sizes: [usize; 2] = [1, 2], unit "pixels", source Taste, effect "none";
        }
    }

    #[test]
    fn a_table_has_what_its_declaration_has() {
        let table = TestTuning::table();
        assert!(table.file.ends_with("tuning.rs"), "{}", table.file);
        assert_eq!(
            (table.name, table.doc, table.constants.len()),
            ("TestTuning", " Constants of a test.\n", 2)
        );
        let [gain, sizes] = &table.constants[..] else { panic!("two constants") };
        assert_eq!((gain.name, &*gain.value, gain.doc), ("min_gain", "0.05", " Least gain.\n"));
        assert_eq!((gain.unit, gain.effect), ("fraction", "a larger value keeps less"));
        assert_eq!(gain.source.to_string(), "measured (here)");
        assert_eq!((&*sizes.value, sizes.source.to_string()), ("[1, 2]", "taste".into()));
        assert_eq!((TEST.min_gain, TEST.sizes), (0.05, [1, 2]));
    }
}
