//! The form of a type, found by reading samples of it.
//!
//! A type's `Deserialize` asks its source for a number, for a struct with these fields, for one of
//! these variants. The source here answers each request with a sample and writes it down. Each run
//! takes one variant of each choice and all fields of each struct; further runs take the other
//! variants, and leave out one field to find out whether it is required. A run is determined by its
//! script: one number per choice or struct in the order of their requests, 0 beyond its end.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use serde::de::value::StrDeserializer;
use serde::de::{
    self, DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, IntoDeserializer, MapAccess,
    SeqAccess, VariantAccess, Visitor,
};
use serde::{Serialize, forward_to_deserialize_any};

use super::{Content, Field, Form, Id, Part, Variant};
use crate::graph::to_ron;

/// A form that nests deeper is not traced.
const MAX_DEPTH: usize = 32;

impl Form {
    /// The form of values of type `T`.
    pub fn of<T: Serialize + DeserializeOwned>() -> Form {
        let mut form =
            Form { root: Part::Unknown, structs: BTreeMap::new(), choices: BTreeMap::new() };
        let mut old_fields = BTreeSet::new();
        let mut scripts = VecDeque::from([Vec::new()]);
        while let Some(script) = scripts.pop_front() {
            let mut tracer = Tracer {
                form: &mut form,
                old_fields: &old_fields,
                script: script.clone(),
                asked: Vec::new(),
                more: &mut scripts,
                found: Part::Unknown,
                given: None,
                omitted: None,
                chosen: None,
                depth: 0,
            };
            let read = T::deserialize(&mut tracer);
            let Tracer { found, given, omitted, chosen, .. } = tracer;
            match (read, omitted, chosen) {
                // A second name of a field that was given already.
                (Err(Error::Duplicate), ..) => {
                    if given.is_some_and(|field| old_fields.insert(field)) {
                        scripts.push_front(script);
                    }
                    continue;
                }
                (Err(Error::Missing(field)), Some((id, left_out)), _) if field == left_out => {
                    form.require(id, field);
                }
                (Ok(value), _, Some((id, name))) => form.mark_old(id, name, &to_ron(&value)),
                _ => {}
            }
            if form.root == Part::Unknown {
                form.root = found;
            }
        }
        for (id, fields) in &mut form.structs {
            fields.retain(|field| !old_fields.contains(&(*id, field.name)));
        }
        form
    }

    fn require(&mut self, id: Id, name: &str) {
        let fields = self.structs.entry(id).or_default();
        fields.iter_mut().filter(|f| f.name == name).for_each(|f| f.required = true);
    }

    /// A name of a variant is an old one where the variant is written by another.
    fn mark_old(&mut self, id: Id, name: &str, written: &str) {
        let is_word = |c: char| c.is_alphanumeric() || c == '_';
        let old = written.split(|c| !is_word(c)).all(|word| word != name);
        let variants = self.choices.entry(id).or_default();
        variants.iter_mut().filter(|v| v.name == name).for_each(|v| v.old = old);
    }
}

/// The source of samples in one run.
struct Tracer<'a> {
    form: &'a mut Form,
    /// Fields that are second names of others.
    old_fields: &'a BTreeSet<(Id, &'static str)>,
    script: Vec<usize>,
    /// The answers so far.
    asked: Vec<usize>,
    /// Scripts of further runs.
    more: &'a mut VecDeque<Vec<usize>>,
    /// The part that was read last.
    found: Part,
    /// The field that was given last.
    given: Option<(Id, &'static str)>,
    /// The field that the last answer of the script leaves out.
    omitted: Option<(Id, &'static str)>,
    /// The variant that the last answer of the script takes.
    chosen: Option<(Id, &'static str)>,
    depth: usize,
}

#[derive(Debug)]
enum Error {
    Missing(&'static str),
    Duplicate,
    Other,
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a sample was refused")
    }
}

impl std::error::Error for Error {}

impl de::Error for Error {
    fn custom<T: std::fmt::Display>(_: T) -> Error {
        Error::Other
    }
    fn missing_field(field: &'static str) -> Error {
        Error::Missing(field)
    }
    fn duplicate_field(_: &'static str) -> Error {
        Error::Duplicate
    }
}

impl Tracer<'_> {
    /// The script's answer to a request with `count` answers, and whether it is the script's last;
    /// where `is_new`, each answer gets a run of its own.
    fn ask(&mut self, count: usize, is_new: bool) -> (usize, bool) {
        let at = self.asked.len();
        let answer = self.script.get(at).copied().unwrap_or(0);
        if is_new && at >= self.script.len() {
            self.more.extend((0..count).map(|other| [&self.asked[..], &[other]].concat()));
        }
        self.asked.push(answer);
        (answer, at + 1 == self.script.len())
    }

    fn inner<'de, S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<(S::Value, Part), Error> {
        if self.depth == MAX_DEPTH {
            return Err(Error::Other);
        }
        self.depth += 1;
        self.found = Part::Unknown;
        let value = seed.deserialize(&mut *self)?;
        self.depth -= 1;
        Ok((value, std::mem::take(&mut self.found)))
    }

    /// A sequence of `count` samples, and their parts.
    fn sequence<'de, V: Visitor<'de>>(
        &mut self,
        count: usize,
        visitor: V,
    ) -> Result<(V::Value, Vec<Part>), Error> {
        let mut items = Items { tracer: self, left: count, parts: Vec::new() };
        let value = visitor.visit_seq(&mut items)?;
        Ok((value, items.parts))
    }

    /// The fields of a struct or of a variant with fields.
    fn fields<'de, V: Visitor<'de>>(&mut self, id: Id, visitor: V) -> Result<V::Value, Error> {
        let is_new = !self.form.structs.contains_key(&id);
        let unknown = |&name: &&'static str| Field { name, part: Part::Unknown, required: false };
        self.form.structs.entry(id).or_insert_with(|| id.1.iter().map(unknown).collect());
        let (answer, is_last) = self.ask(id.1.len() + 1, is_new);
        let left_out = answer.checked_sub(1).map(|at| id.1[at]);
        if is_last {
            self.omitted = left_out.map(|name| (id, name));
        }
        let is_given =
            |name: &&str| Some(*name) != left_out && !self.old_fields.contains(&(id, *name));
        let names = id.1.iter().copied().filter(is_given).collect();
        visitor.visit_map(Fields { tracer: self, id, names })
    }
}

/// Reads one part of a plain kind.
macro_rules! plain {
    ($($method:ident $visit:ident $sample:expr, $part:expr;)*) => { $(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            let value = visitor.$visit($sample)?;
            self.found = $part;
            Ok(value)
        }
    )* };
}

impl<'de> Deserializer<'de> for &mut Tracer<'_> {
    type Error = Error;

    plain! {
        deserialize_bool visit_bool true, Part::Flag;
        deserialize_i8 visit_i8 1, Part::Whole;
        deserialize_i16 visit_i16 1, Part::Whole;
        deserialize_i32 visit_i32 1, Part::Whole;
        deserialize_i64 visit_i64 1, Part::Whole;
        deserialize_u8 visit_u8 1, Part::Whole;
        deserialize_u16 visit_u16 1, Part::Whole;
        deserialize_u32 visit_u32 1, Part::Whole;
        deserialize_u64 visit_u64 1, Part::Whole;
        deserialize_f32 visit_f32 0.5, Part::Number;
        deserialize_f64 visit_f64 0.5, Part::Number;
        deserialize_str visit_str "sample", Part::Text;
        deserialize_string visit_str "sample", Part::Text;
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Error> {
        Err(Error::Other)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let value = visitor.visit_some(&mut *self)?;
        self.found = Part::Optional(Box::new(std::mem::take(&mut self.found)));
        Ok(value)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let (value, mut parts) = self.sequence(1, visitor)?;
        self.found = Part::List(Box::new(parts.pop().unwrap_or_default()));
        Ok(value)
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, n: usize, visitor: V) -> Result<V::Value, Error> {
        let (value, parts) = self.sequence(n, visitor)?;
        self.found = Part::Tuple(parts);
        Ok(value)
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        n: usize,
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.deserialize_tuple(n, visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let mut entries = Entry { tracer: self, given: false, part: Part::Unknown };
        let value = visitor.visit_map(&mut entries)?;
        let part = entries.part;
        self.found = Part::Map(Box::new(part));
        Ok(value)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        let value = self.fields((name, fields), visitor)?;
        self.found = Part::Struct((name, fields));
        Ok(value)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        let id = (name, variants);
        let is_new = !self.form.choices.contains_key(&id);
        let unknown =
            |&name: &&'static str| Variant { name, content: Content::Nothing, old: false };
        self.form.choices.entry(id).or_insert_with(|| variants.iter().map(unknown).collect());
        let (answer, is_last) = self.ask(variants.len(), is_new);
        if is_last {
            self.chosen = Some((id, variants[answer]));
        }
        let value = visitor.visit_enum(Choice { tracer: self, id, at: answer })?;
        self.found = Part::Choice(id);
        Ok(value)
    }

    forward_to_deserialize_any! {
        i128 u128 char bytes byte_buf unit unit_struct identifier ignored_any
    }
}

struct Items<'a, 'b> {
    tracer: &'a mut Tracer<'b>,
    left: usize,
    parts: Vec<Part>,
}

impl<'de> SeqAccess<'de> for &mut Items<'_, '_> {
    type Error = Error;
    fn next_element_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, Error> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        let (value, part) = self.tracer.inner(seed)?;
        self.parts.push(part);
        Ok(Some(value))
    }
}

/// A map of one entry.
struct Entry<'a, 'b> {
    tracer: &'a mut Tracer<'b>,
    given: bool,
    part: Part,
}

impl<'de> MapAccess<'de> for &mut Entry<'_, '_> {
    type Error = Error;
    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, Error> {
        if std::mem::replace(&mut self.given, true) {
            return Ok(None);
        }
        Ok(Some(self.tracer.inner(seed)?.0))
    }
    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, Error> {
        let (value, part) = self.tracer.inner(seed)?;
        self.part = part;
        Ok(value)
    }
}

struct Fields<'a, 'b> {
    tracer: &'a mut Tracer<'b>,
    id: Id,
    /// The fields that are still to come.
    names: VecDeque<&'static str>,
}

impl<'de> MapAccess<'de> for Fields<'_, '_> {
    type Error = Error;
    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, Error> {
        let Some(name) = self.names.pop_front() else { return Ok(None) };
        self.tracer.given = Some((self.id, name));
        let key: StrDeserializer<Error> = name.into_deserializer();
        seed.deserialize(key).map(Some)
    }
    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, Error> {
        let given = self.tracer.given;
        let (value, part) = self.tracer.inner(seed)?;
        let fields = self.tracer.form.structs.entry(self.id).or_default();
        let field = fields.iter_mut().find(|field| given == Some((self.id, field.name)));
        if let Some(field) = field.filter(|field| field.part == Part::Unknown) {
            field.part = part;
        }
        Ok(value)
    }
}

struct Choice<'a, 'b> {
    tracer: &'a mut Tracer<'b>,
    id: Id,
    /// The variant, by its place in the list.
    at: usize,
}

impl Choice<'_, '_> {
    fn note(self, content: Content) {
        if let Some(variants) = self.tracer.form.choices.get_mut(&self.id) {
            variants[self.at].content = content;
        }
    }
}

impl<'de> EnumAccess<'de> for Choice<'_, '_> {
    type Error = Error;
    type Variant = Self;
    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), Error> {
        let name: StrDeserializer<Error> = self.id.1[self.at].into_deserializer();
        Ok((seed.deserialize(name)?, self))
    }
}

impl<'de> VariantAccess<'de> for Choice<'_, '_> {
    type Error = Error;

    fn unit_variant(self) -> Result<(), Error> {
        Ok(())
    }

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, Error> {
        let (value, part) = self.tracer.inner(seed)?;
        self.note(Content::One(part));
        Ok(value)
    }

    fn tuple_variant<V: Visitor<'de>>(self, n: usize, visitor: V) -> Result<V::Value, Error> {
        let (value, parts) = self.tracer.sequence(n, visitor)?;
        self.note(Content::Several(parts));
        Ok(value)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        let id = (self.id.1[self.at], fields);
        let value = self.tracer.fields(id, visitor)?;
        self.note(Content::Fields(id));
        Ok(value)
    }
}
