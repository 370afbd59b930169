//! A serde deserializer of a parsed TOML value. Its error contains the key at fault, the known keys and the location in
//! the text as separate fields; the error of `toml` has them only in its message. A number that is not finite is
//! refused here, so that no number from a machine file is infinite or NaN.

use std::borrow::Cow;
use std::fmt;

use serde::de::value::{MapAccessDeserializer, SeqDeserializer};
use serde::de::{DeserializeSeed, Deserializer, Error, Expected, IntoDeserializer, MapAccess, Unexpected, Visitor};
use serde::forward_to_deserialize_any;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Kind of fault in a value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ValueFaultKind {
    UnknownKey {
        key: String,
        known: &'static [&'static str],
    },
    MissingKey {
        key: &'static str,
    },
    /// A text that is none of the `known` values.
    UnknownValue {
        value: String,
        known: &'static [&'static str],
    },
    /// Any other fault of a value; the text continues a sentence that begins with the key.
    InvalidValue(String),
}

/// A fault with its location in the text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ValueFault {
    pub kind: ValueFaultKind,
    /// Keys from the value that is being read down to the value at fault, outermost first; for an unknown or missing
    /// key, without that key.
    pub key_path: Vec<String>,
    /// Byte offset in the text, of an unknown key or of the value at fault; `None` until it is known.
    pub byte_offset: Option<usize>,
}

impl ValueFault {
    fn new(kind: ValueFaultKind) -> Self {
        Self { kind, key_path: Vec::new(), byte_offset: None }
    }

    fn with_offset_if_missing(mut self, offset: usize) -> Self {
        self.byte_offset.get_or_insert(offset);
        self
    }

    /// Adds `key` as the outermost of the path.
    fn within_key(mut self, key: &str) -> Self {
        self.key_path.insert(0, key.to_owned());
        self
    }
}

impl fmt::Display for ValueFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {:?}", self.key_path.join("."), self.kind)
    }
}

impl std::error::Error for ValueFault {}

impl Error for ValueFault {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::new(ValueFaultKind::InvalidValue(message.to_string()))
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::custom(format_args!("must be {}, not {found}", describe_expected_type(expected)))
    }

    fn invalid_length(length: usize, expected: &dyn Expected) -> Self {
        Self::custom(format_args!("has {length} elements, must be {expected}"))
    }

    fn unknown_variant(value: &str, known: &'static [&'static str]) -> Self {
        Self::new(ValueFaultKind::UnknownValue { value: value.to_owned(), known })
    }

    fn unknown_field(key: &str, known: &'static [&'static str]) -> Self {
        Self::new(ValueFaultKind::UnknownKey { key: key.to_owned(), known })
    }

    fn missing_field(key: &'static str) -> Self {
        Self::new(ValueFaultKind::MissingKey { key })
    }
}

/// The expected type in words that a machinist understands, not `f64`.
fn describe_expected_type(expected: &dyn Expected) -> String {
    match expected.to_string().as_str() {
        "f32" | "f64" => "a number".to_owned(),
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, not negative".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number".to_owned(),
        other if other.starts_with("struct ") => "a table".to_owned(),
        other => other.to_owned(),
    }
}

/// A value of the file, ready to be deserialized; errors contain its location.
pub struct LocatedValue<'i>(pub Spanned<DeValue<'i>>);

impl<'de> LocatedValue<'de> {
    /// The table without one of its keys.
    pub fn without_key(mut self, key: &str) -> Self {
        if let DeValue::Table(table) = self.0.get_mut() {
            table.remove(key);
        }
        self
    }

    fn visit<V: Visitor<'de>>(value: DeValue<'de>, visitor: V) -> Result<V::Value, ValueFault> {
        match value {
            DeValue::String(Cow::Borrowed(text)) => visitor.visit_borrowed_str(text),
            DeValue::String(Cow::Owned(text)) => visitor.visit_string(text),
            DeValue::Integer(number) => match i64::from_str_radix(number.as_str(), number.radix()) {
                Ok(number) => visitor.visit_i64(number),
                Err(_) => Err(ValueFault::custom("is too large a number")),
            },
            DeValue::Float(number) => match number.as_str().parse::<f64>() {
                Ok(number) if number.is_finite() => visitor.visit_f64(number),
                _ => Err(ValueFault::custom("must be a finite number")),
            },
            DeValue::Boolean(value) => visitor.visit_bool(value),
            DeValue::Datetime(value) => visitor.visit_string(value.to_string()),
            DeValue::Array(array) => {
                let mut elements = SeqDeserializer::new(array.into_iter().map(LocatedValue));
                let value = visitor.visit_seq(&mut elements)?;
                elements.end()?;
                Ok(value)
            }
            DeValue::Table(table) => visitor.visit_map(TableEntries::new(table)),
        }
    }
}

impl<'de> Deserializer<'de> for LocatedValue<'de> {
    type Error = ValueFault;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueFault> {
        let offset = self.0.span().start;
        Self::visit(self.0.into_inner(), visitor).map_err(|fault| fault.with_offset_if_missing(offset))
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ValueFault> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, ValueFault> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ValueFault> {
        let offset = self.0.span().start;
        match self.0.into_inner() {
            DeValue::String(text) => visitor.visit_enum(text.into_deserializer()),
            DeValue::Table(table) => visitor.visit_enum(MapAccessDeserializer::new(TableEntries::new(table))),
            other => Err(ValueFault::custom(format_args!("must be a string, not a {}", other.type_str()))),
        }
        .map_err(|fault: ValueFault| fault.with_offset_if_missing(offset))
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit
        unit_struct seq tuple tuple_struct map struct identifier ignored_any
    }
}

impl<'de> IntoDeserializer<'de, ValueFault> for LocatedValue<'de> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

/// Reads `value`, and adds the location to a fault without one. A tagged or flattened type is read from serde's
/// own buffer without locations: its unknown key is searched for in the text.
pub fn deserialize_with_location<'i, T>(
    value: Spanned<DeValue<'i>>,
    read: impl FnOnce(LocatedValue<'i>) -> Result<T, ValueFault>,
) -> Result<T, ValueFault> {
    let offset = value.span().start;
    let mut keys = Vec::new();
    collect_keys_and_offsets(value.get_ref(), &mut keys);
    read(LocatedValue(value)).map_err(|fault| match &fault.kind {
        ValueFaultKind::UnknownKey { key, .. } => {
            let found = keys.iter().find(|(name, _)| name == key).map_or(offset, |(_, offset)| *offset);
            fault.with_offset_if_missing(found)
        }
        _ => fault.with_offset_if_missing(offset),
    })
}

/// Appends the name and the byte offset of each key below `value`.
fn collect_keys_and_offsets(value: &DeValue<'_>, keys_and_offsets: &mut Vec<(String, usize)>) {
    match value {
        DeValue::Table(table) => {
            for (key, value) in table {
                keys_and_offsets.push((key.get_ref().to_string(), key.span().start));
                collect_keys_and_offsets(value.get_ref(), keys_and_offsets);
            }
        }
        DeValue::Array(array) => {
            array.iter().for_each(|value| collect_keys_and_offsets(value.get_ref(), keys_and_offsets));
        }
        _ => {}
    }
}

/// Entries of a table in the order of the text, so that the first error is the topmost.
struct TableEntries<'i> {
    /// Entries whose key has not been read.
    remaining_entries: std::vec::IntoIter<(Spanned<Cow<'i, str>>, Spanned<DeValue<'i>>)>,
    /// Entry whose key has been read, and whose value has not.
    pending_key_and_value: Option<(String, Spanned<DeValue<'i>>)>,
}

impl<'de> TableEntries<'de> {
    fn new(table: DeTable<'de>) -> Self {
        let mut entries: Vec<_> = table.into_iter().collect();
        entries.sort_by_key(|(key, _)| key.span().start);
        Self { remaining_entries: entries.into_iter(), pending_key_and_value: None }
    }
}

impl<'de> MapAccess<'de> for TableEntries<'de> {
    type Error = ValueFault;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, ValueFault> {
        let Some((key, value)) = self.remaining_entries.next() else { return Ok(None) };
        let offset = key.span().start;
        let key = key.into_inner();
        self.pending_key_and_value = Some((key.to_string(), value));
        seed.deserialize(key.into_deserializer()).map(Some).map_err(|fault: ValueFault| {
            let kind = match fault.kind {
                ValueFaultKind::UnknownValue { value, known } => ValueFaultKind::UnknownKey { key: value, known },
                other => other,
            };
            ValueFault { kind, ..fault }.with_offset_if_missing(offset)
        })
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, ValueFault> {
        let Some((key, value)) = self.pending_key_and_value.take() else {
            return Err(ValueFault::custom("a value was requested before its key"));
        };
        deserialize_with_location(value, |value| seed.deserialize(value)).map_err(|fault| fault.within_key(&key))
    }
}
