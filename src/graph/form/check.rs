//! A value against its form: each fault at its place, with the wanted form and the likely meaning.

use super::{Content, Field, Form, Id, Part, Variant};
use crate::graph::diagnostics::Diagnostics;
use crate::graph::raw::{Key, Raw};
use crate::graph::source::{Diagnostic, nearest};

impl Form {
    /// Adds the faults of a value that was refused, each at its own place; `name` is that of the
    /// value. At least one is added.
    pub(in crate::graph) fn refuse(&self, name: &str, value: &Raw, faults: &mut Diagnostics) {
        let before = faults.found();
        Check { form: self, faults }.part(name, value, &self.root);
        if faults.found() == before {
            faults.push(|| {
                value.fault(wanted(name, &self.wanted(&self.root), value)).help(
                    "the brackets, commas and quotes may be wrong: docs/files.md shows each form",
                )
            });
        }
    }

    /// Whether a value has the form of `part`.
    fn accepts(&self, value: &Raw, part: &Part) -> bool {
        let mut faults = Diagnostics::ignored();
        Check { form: self, faults: &mut faults }.part("", value, part);
        faults.is_empty()
    }
}

fn wanted(name: &str, wanted: &str, value: &Raw) -> String {
    format!("`{name}` wanted {wanted}, got `{}`", value.short())
}

struct Check<'a> {
    form: &'a Form,
    faults: &'a mut Diagnostics,
}

impl Check<'_> {
    fn part(&mut self, name: &str, value: &Raw, part: &Part) {
        let text = value.text();
        let is_sound = match part {
            Part::Unknown => true,
            Part::Number => text.parse::<f64>().is_ok() || value.parse::<f64>().is_some(),
            Part::Whole => value.parse::<u64>().is_some() || value.parse::<i64>().is_some(),
            Part::Flag => matches!(text, "true" | "false"),
            Part::Text => value.string().is_some(),
            Part::Optional(_) if text == "None" => true,
            Part::Optional(inner) => {
                let some = (value.variant() == Some("Some")).then(|| value.only_item()).flatten();
                return self.part(name, some.as_ref().unwrap_or(value), inner);
            }
            Part::List(item) if text.starts_with('[') => {
                let items = value.as_list(self.faults);
                return items.iter().for_each(|value| self.part(name, value, item));
            }
            Part::Map(item) if text.starts_with('{') => {
                let entries = value.as_map(self.faults);
                return entries.iter().for_each(|(key, value)| self.part(&key.name, value, item));
            }
            Part::Tuple(parts) if text.starts_with('(') => return self.tuple(name, value, parts),
            Part::Struct(id) if text.starts_with('(') || value.variant() == Some(id.0) => {
                return self.fields(name, value, *id);
            }
            Part::Choice(id) => return self.choice(name, value, *id),
            Part::List(_) | Part::Map(_) | Part::Tuple(_) | Part::Struct(_) => false,
        };
        if !is_sound {
            let help = help(value, part);
            self.faults.push(|| {
                let fault = value.fault(wanted(name, &self.form.wanted(part), value));
                help.into_iter().fold(fault, Diagnostic::help)
            });
        }
    }

    /// `(a, b)`, or the content of `Name(a, b)`.
    fn tuple(&mut self, name: &str, value: &Raw, parts: &[Part]) {
        let items = value.as_tuple(self.faults);
        if items.len() == parts.len() {
            let pairs = items.iter().zip(parts);
            return pairs.for_each(|(value, part)| self.part(name, value, part));
        }
        self.faults.push(|| {
            let count = if parts.len() == 1 { "one value" } else { "values" };
            let form = match value.variant().and_then(|_| self.form.variant_call(value)) {
                Some(call) => call,
                None => self.form.sketch(&Part::Tuple(parts.to_vec())),
            };
            let number = if parts.len() == 1 { String::new() } else { format!("{} ", parts.len()) };
            let message = format!("`{name}` wanted {number}{count} `{form}`, got {}", items.len());
            let fault = value.fault(message);
            match items.windows(2).find_map(|pair| pair[0].decimal_comma(&pair[1])) {
                Some(help) => fault.help(help),
                None => fault,
            }
        });
    }

    /// `(field: value, ..)`, or the content of `Name(field: value, ..)`.
    fn fields(&mut self, name: &str, value: &Raw, id: Id) {
        let fields = self.form.structs.get(&id).map_or(&[][..], Vec::as_slice);
        let before = self.faults.found();
        let variant = value.variant().unwrap_or_default();
        if let Some(named) = self.form.named(value, fields) {
            return self.faults.push(|| {
                let form = self.form.fields(id);
                let fault =
                    value.fault(format!("wanted `{variant}({form})`, got `{}`", value.short()));
                fault.help(format!("write the names, too: `{variant}({named})`"))
            });
        }
        let given = value.fields(&format!("`{variant}({})`", self.form.fields(id)), self.faults);
        for (key, value) in &given {
            match fields.iter().find(|field| field.name == key.name) {
                Some(field) => self.part(field.name, value, &field.part),
                None if id.1.contains(&key.name.as_str()) => {}
                None => self.unknown_field(name, key, fields),
            }
        }
        let is_given = |field: &&Field| given.iter().any(|(key, _)| key.name == field.name);
        let missing = fields.iter().filter(|field| field.required && !is_given(field));
        // A misspelt field is the fault, not the field without it.
        for field in missing.filter(|_| self.faults.found() == before).collect::<Vec<_>>() {
            self.faults.push(|| {
                let place = value.variant_origin();
                let example = format!("{}: {}", field.name, self.form.sketch(&field.part));
                Diagnostic::at(
                    &place,
                    format!("`{name}` wanted a field `{}`, got none", field.name),
                )
                .help(format!("write `{example}`"))
            });
        }
    }

    fn unknown_field(&mut self, name: &str, key: &Key, fields: &[Field]) {
        self.faults.push(|| {
            let message = format!("`{name}` has no field `{}`", key.name);
            let fault = Diagnostic::at(&key.origin, message);
            fault.suggest(&key.name, fields.iter().map(|field| field.name))
        });
    }

    fn choice(&mut self, name: &str, value: &Raw, id: Id) {
        let all = self.form.choices.get(&id).map_or(&[][..], Vec::as_slice);
        match value.variant().map(|own| (own, all.iter().find(|v| v.name == own))) {
            Some((own, Some(variant))) => self.content(own, value, variant),
            own => self.faults.push(|| {
                let place =
                    if own.is_some() { value.variant_origin() } else { value.origin.clone() };
                let got = own.map_or_else(|| value.short(), |(own, _)| own.to_owned());
                let form = self.form.wanted(&Part::Choice(id));
                let fault = Diagnostic::at(&place, format!("`{name}` wanted {form}, got `{got}`"));
                let help = self.form.meant(value, id);
                help.into_iter().fold(fault, Diagnostic::help)
            }),
        }
    }

    /// The part of a variant in parentheses.
    fn content(&mut self, name: &str, value: &Raw, variant: &Variant) {
        let is_bare = value.text() == name;
        match &variant.content {
            Content::Nothing if is_bare => {}
            Content::Nothing => self.faults.push(|| {
                let message = format!("`{name}` wanted nothing behind it, got `{}`", value.short());
                value.fault(message).help(format!("write `{name}`"))
            }),
            _ if is_bare => self.faults.push(|| {
                let call = self.form.call(variant);
                let message = format!("wanted `{call}`, got `{name}` alone");
                let fields = match &variant.content {
                    Content::Fields(id) => self.form.structs.get(id),
                    _ => None,
                };
                let optional = fields.is_some_and(|f| f.iter().all(|field| !field.required));
                let fault = value.fault(message);
                if optional { fault.help(format!("write `{name}()`")) } else { fault }
            }),
            Content::One(Part::Struct(id)) if value.only_item().is_none() => {
                self.fields(name, value, *id);
            }
            Content::One(Part::Tuple(parts)) if value.only_item().is_none() => {
                self.tuple(name, value, parts);
            }
            Content::One(part) => self.tuple(name, value, std::slice::from_ref(part)),
            Content::Several(parts) => self.tuple(name, value, parts),
            Content::Fields(id) => self.fields(name, value, *id),
        }
    }
}

impl Form {
    /// The content of a value that gives the first of its `fields` in their order without names.
    fn named(&self, value: &Raw, fields: &[Field]) -> Option<String> {
        let items = value.as_tuple(&mut Diagnostics::ignored());
        let is_meant = |(item, field): (&Raw, &Field)| {
            item.split_key().is_none() && self.accepts(item, &field.part)
        };
        let pairs = || items.iter().zip(fields);
        let all = !items.is_empty() && items.len() <= fields.len() && pairs().all(is_meant);
        let name = |(item, field): (&Raw, &Field)| format!("{}: {}", field.name, item.text());
        all.then(|| pairs().map(name).collect::<Vec<_>>().join(", "))
    }

    /// The form of the variant that a value begins with.
    fn variant_call(&self, value: &Raw) -> Option<String> {
        let name = value.variant()?;
        let found = self.choices.values().flatten().find(|variant| variant.name == name)?;
        Some(self.call(found))
    }

    /// The variant that a person may have meant by a value that begins with none.
    fn meant(&self, value: &Raw, id: Id) -> Option<String> {
        let offered = self.offered(id);
        let named = |text: &str| nearest(text, offered.iter().map(|variant| variant.name));
        if let Some(text) = value.string()
            && offered.iter().any(|variant| variant.name == text)
        {
            return Some(format!("write it without quotes: `{text}`"));
        }
        let takes = |variant: &&&Variant| match &variant.content {
            Content::One(part) => self.accepts(value, part),
            Content::Several(parts) => self.accepts(value, &Part::Tuple(parts.clone())),
            Content::Nothing | Content::Fields(_) => false,
        };
        if value.variant().is_none()
            && let Some(variant) = offered.iter().find(takes)
        {
            let inner = value.text().trim_start_matches('(').trim_end_matches(')');
            return Some(format!("did you mean `{}({inner})`?", variant.name));
        }
        let is_file = |text: &String| text.contains(['.', '/']);
        let word = value
            .string()
            .filter(|text| !is_file(text))
            .or_else(|| value.variant().map(str::to_owned))?;
        named(&word).map(|near| format!("did you mean `{near}`?"))
    }
}

/// The likely meaning of a value that is not of a plain part.
fn help(value: &Raw, part: &Part) -> Option<String> {
    let text = value.text();
    let quoted = value.string();
    match part {
        Part::Number | Part::Whole => {
            let inner = quoted.as_deref().unwrap_or(text).trim();
            let comma = inner.replacen(',', ".", 1);
            if inner.contains(',') && comma.parse::<f64>().is_ok() {
                return Some(format!("a decimal comma? Write `{comma}`"));
            }
            if inner.starts_with('#') {
                return Some("a color such as `#ff8800` is not a number here".to_owned());
            }
            if quoted.is_some() && inner.parse::<f64>().is_ok() {
                return Some(format!("write it without quotes: `{inner}`"));
            }
            if let Some((_, number)) = inner.split_once(':')
                && number.trim().parse::<f64>().is_ok()
            {
                return Some(format!("write it without a name: `{}`", number.trim()));
            }
            let number = inner.parse::<f64>().ok().filter(|_| *part == Part::Whole);
            number.map(|number| format!("write `{}`", number.abs().round()))
        }
        Part::Flag => match quoted.as_deref().unwrap_or(text).to_lowercase().as_str() {
            "true" | "yes" | "on" | "1" => Some("write `true`".to_owned()),
            "false" | "no" | "off" | "0" => Some("write `false`".to_owned()),
            _ => None,
        },
        Part::Text => {
            let is_plain = !text.contains(['"', '(', '[', '{', '\n']);
            is_plain.then(|| format!("write it in quotes: \"{}\"", text.replace('\\', "/")))
        }
        Part::List(_) if !text.starts_with(['{', '[']) => {
            Some(format!("write `[{}]`", value.short()))
        }
        Part::Tuple(_) if text.starts_with('[') => {
            let inner = text.trim_start_matches('[').trim_end_matches(']');
            Some(format!("write `({inner})`"))
        }
        Part::Map(_) if text.starts_with(['(', '[']) => {
            Some("names and values stand in braces: `{ \"name\": .. }`".to_owned())
        }
        _ => None,
    }
}
