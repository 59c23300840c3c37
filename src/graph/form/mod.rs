//! The form in which a file gives a value: the wanted form of messages and of the reference.
//!
//! A form comes from the type itself: [`Form::of`] traces how the type is read ([`trace`]), so that
//! a message, the reference and the reader cannot disagree.

mod check;
mod sketch;
pub(super) mod syntax;
mod trace;

use std::collections::BTreeMap;

/// The form of a value, with the definitions of all named parts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Form {
    root: Part,
    structs: BTreeMap<Id, Vec<Field>>,
    choices: BTreeMap<Id, Vec<Variant>>,
}

/// One part of a form.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
enum Part {
    /// A form that could not be traced.
    #[default]
    Unknown,
    Number,
    Whole,
    Flag,
    Text,
    Optional(Box<Part>),
    List(Box<Part>),
    Tuple(Vec<Part>),
    Map(Box<Part>),
    /// `(field: value, ..)`
    Struct(Id),
    /// One of several variants.
    Choice(Id),
}

/// A name, and the names of its fields or variants, as two types may share a name.
type Id = (&'static str, &'static [&'static str]);

#[derive(Clone, Debug, PartialEq, Eq)]
struct Field {
    name: &'static str,
    part: Part,
    required: bool,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Variant {
    name: &'static str,
    content: Content,
    /// An old name, which files may use and messages do not offer.
    old: bool,
}

/// The part of a value in parentheses behind the name of its variant.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Content {
    Nothing,
    One(Part),
    Several(Vec<Part>),
    Fields(Id),
}

impl Form {
    /// Whether every part is known.
    pub fn is_known(&self) -> bool {
        fn known(part: &Part) -> bool {
            match part {
                Part::Unknown => false,
                Part::Optional(part) | Part::List(part) | Part::Map(part) => known(part),
                Part::Tuple(parts) => parts.iter().all(known),
                _ => true,
            }
        }
        let of_content = |variant: &Variant| match &variant.content {
            Content::One(part) => known(part),
            Content::Several(parts) => parts.iter().all(known),
            Content::Nothing | Content::Fields(_) => true,
        };
        known(&self.root)
            && self.structs.values().flatten().all(|field| known(&field.part))
            && self.choices.values().flatten().all(of_content)
    }
}
