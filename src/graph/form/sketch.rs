//! A form in the words of messages and of the reference.

use std::fmt::{self, Display, Formatter};

use super::{Content, Field, Form, Id, Part, Variant};

/// A variant with more fields is shown by its required ones.
const MAX_FIELDS: usize = 3;
/// In a choice of more variants, fields are left out.
const MAX_CALLS: usize = 4;

impl Form {
    /// The wanted form in words with an example: ``a number, such as `0.5` ``.
    pub(super) fn wanted(&self, part: &Part) -> String {
        match part {
            Part::Unknown => "another value".to_owned(),
            Part::Number => "a number, such as `0.5`".to_owned(),
            Part::Whole => "a whole number, such as `12`".to_owned(),
            Part::Flag => "`true` or `false`".to_owned(),
            Part::Text => "a text in quotes, such as `\"name\"`".to_owned(),
            Part::Optional(part) => format!("{} (or `None`)", self.wanted(part)),
            Part::List(_) => format!("a list `{}`", self.sketch(part)),
            Part::Tuple(parts) => format!("{} values `{}`", parts.len(), self.sketch(part)),
            Part::Map(_) | Part::Struct(_) => format!("`{}`", self.sketch(part)),
            Part::Choice(id) => {
                let offered = self.offered(*id);
                let short = offered.len() > MAX_CALLS;
                let call = |variant: &&Variant| match &variant.content {
                    Content::Fields(_) if short => format!("`{}(..)`", variant.name),
                    _ => format!("`{}`", self.call(variant)),
                };
                let all: Vec<String> = offered.iter().map(call).collect();
                match &all[..] {
                    [first @ .., last] if !first.is_empty() => {
                        format!("{} or {last}", first.join(", "))
                    }
                    _ => all.concat(),
                }
            }
        }
    }

    /// The form of one value in a file, with words in the place of numbers.
    pub(super) fn sketch(&self, part: &Part) -> String {
        match part {
            Part::Unknown => "value".to_owned(),
            Part::Number => "number".to_owned(),
            Part::Whole => "whole number".to_owned(),
            Part::Flag => "true or false".to_owned(),
            Part::Text => "\"text\"".to_owned(),
            Part::Optional(part) => self.sketch(part),
            Part::List(part) => format!("[{}, ..]", self.short(part)),
            Part::Tuple(parts) => format!("({})", self.list(parts)),
            Part::Map(part) => format!("{{ \"name\": {}, .. }}", self.short(part)),
            Part::Struct(id) => format!("({})", self.fields(*id)),
            Part::Choice(id) => {
                let all: Vec<String> =
                    self.offered(*id).iter().map(|variant| self.call(variant)).collect();
                all.join(" or ")
            }
        }
    }

    /// The same, of a choice only that it is one.
    fn short(&self, part: &Part) -> String {
        match part {
            Part::Choice(_) => "..".to_owned(),
            Part::Optional(part) => self.short(part),
            part => self.sketch(part),
        }
    }

    /// The variants of a choice by their present names.
    pub(super) fn offered(&self, id: Id) -> Vec<&Variant> {
        self.choices.get(&id).into_iter().flatten().filter(|variant| !variant.old).collect()
    }

    /// The form of a variant: `Off`, `Scale(number)`, `Sphere(radius: number)`.
    pub(super) fn call(&self, variant: &Variant) -> String {
        match &variant.content {
            Content::Nothing => variant.name.to_owned(),
            Content::One(part) => format!("{}({})", variant.name, self.short(part)),
            Content::Several(parts) => format!("{}({})", variant.name, self.list(parts)),
            Content::Fields(id) => format!("{}({})", variant.name, self.fields(*id)),
        }
    }

    fn list(&self, parts: &[Part]) -> String {
        parts.iter().map(|part| self.short(part)).collect::<Vec<_>>().join(", ")
    }

    /// The required fields, and the others where they are few.
    pub(super) fn fields(&self, id: Id) -> String {
        let all = self.structs.get(&id).map_or(&[][..], Vec::as_slice);
        let few = all.len() <= MAX_FIELDS;
        let is_shown = |field: &&Field| few || field.required;
        let shown = all.iter().filter(is_shown);
        let mut shown: Vec<String> =
            shown.map(|field| format!("{}: {}", field.name, self.short(&field.part))).collect();
        if shown.len() < all.len() {
            shown.push("..".to_owned());
        }
        shown.join(", ")
    }
}

impl Display for Form {
    /// The form as the reference shows it.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match &self.root {
            Part::Optional(part) => write!(f, "`{}` or `None`", self.sketch(part)),
            part => write!(f, "`{}`", self.sketch(part)),
        }
    }
}
