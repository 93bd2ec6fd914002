//! Parses JSON by the schema. Errors start with a JSON pointer to the faulty value (RFC 6901).

use std::{cell::Cell, fmt};

use serde::{
    Deserialize, Deserializer,
    de::{DeserializeOwned, DeserializeSeed, Error, IgnoredAny, MapAccess, SeqAccess, Unexpected, Visitor},
};
use serde_json::{Map, Number, Value, from_value};

use super::schema::{Kind, Property};
use crate::limits::MAX_ELEMENT_VALUES;

/// Parses a value of one kind.
#[derive(Clone, Copy)]
struct Parser<'a> {
    kind: &'static Kind,
    /// Values that may still be kept.
    left: &'a Cell<usize>,
}

/// Parses the value of a property.
/// Errors if the value is not of its kind, or holds more than [`MAX_ELEMENT_VALUES`] values.
pub(super) fn property<'de, A: MapAccess<'de>, T: DeserializeOwned>(
    map: &mut A,
    property: &'static Property,
) -> Result<T, A::Error> {
    let left = Cell::new(MAX_ELEMENT_VALUES);
    let value = map.next_value_seed(Parser { kind: property.kind(), left: &left });
    let value = value.and_then(|value| from_value(value).map_err(A::Error::custom));
    value.map_err(|error| at(property.name(), &error))
}

/// Parses a list property. Each element becomes a `T` before the next is parsed: a [`Value`] is large.
/// Errors as [`property`], if the list is too long, or if `build` fails.
pub(super) fn list<'de, A: MapAccess<'de>, T>(
    map: &mut A,
    property: &'static Property,
    build: impl FnMut(Value) -> Result<T, serde_json::Error>,
) -> Result<Vec<T>, A::Error> {
    map.next_value_seed(Elements { kind: property.kind(), build }).map_err(|error| at(property.name(), &error))
}

/// Prefixes an error with a step of its JSON pointer.
fn at<E: Error>(place: impl fmt::Display, error: &E) -> E {
    let error = error.to_string();
    E::custom(if error.starts_with('/') { format!("/{place}{error}") } else { format!("/{place}: {error}") })
}

struct Elements<F> {
    kind: &'static Kind,
    build: F,
}

impl<'de, T, F: FnMut(Value) -> Result<T, serde_json::Error>> DeserializeSeed<'de> for Elements<F> {
    type Value = Vec<T>;
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Vec<T>, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, T, F: FnMut(Value) -> Result<T, serde_json::Error>> Visitor<'de> for Elements<F> {
    type Value = Vec<T>;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.kind)
    }
    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<Vec<T>, A::Error> {
        let Kind::List(max, kind) = self.kind else { return Err(A::Error::invalid_type(Unexpected::Seq, &self)) };
        let mut out = Vec::new();
        let left = Cell::new(MAX_ELEMENT_VALUES);
        let parser = Parser { kind, left: &left };
        while let Some(value) = list.next_element_seed(parser).map_err(|error| at(out.len(), &error))? {
            if out.len() == *max {
                return Err(A::Error::custom(format_args!("more than {max} elements")));
            }
            out.push((self.build)(value).map_err(|error| at(out.len(), &A::Error::custom(error)))?);
            left.set(MAX_ELEMENT_VALUES);
        }
        Ok(out)
    }
}

/// Looks up a property by name. `None` if it is not read.
pub(super) struct PropertyName(pub(super) &'static [Property]);

impl<'de> DeserializeSeed<'de> for PropertyName {
    type Value = Option<&'static Property>;
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_identifier(self)
    }
}

impl Visitor<'_> for PropertyName {
    type Value = Option<&'static Property>;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a name")
    }
    fn visit_str<E: Error>(self, text: &str) -> Result<Self::Value, E> {
        Ok(self.0.iter().find(|property| property.name() == text))
    }
}

impl<'de> DeserializeSeed<'de> for Parser<'_> {
    type Value = Value;
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        let Some(left) = self.left.get().checked_sub(1) else {
            return Err(D::Error::custom(format_args!("more than {MAX_ELEMENT_VALUES} values")));
        };
        self.left.set(left);
        match self.kind {
            Kind::Presence => {
                let value = Option::<IgnoredAny>::deserialize(deserializer)?;
                Ok(value.map_or(Value::Null, |_| Value::Bool(true)))
            }
            _ => deserializer.deserialize_any(self),
        }
    }
}

impl<'de> Visitor<'de> for Parser<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.kind)
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<Value, E> {
        match self.kind {
            Kind::Flag => Ok(value.into()),
            _ => Err(E::invalid_type(Unexpected::Bool(value), &self)),
        }
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Value, E> {
        match self.kind {
            Kind::Number | Kind::Size => Ok(value.into()),
            Kind::Index if u32::try_from(value).is_ok() => Ok(value.into()),
            Kind::Index => Err(E::invalid_value(Unexpected::Unsigned(value), &self)),
            _ => Err(E::invalid_type(Unexpected::Unsigned(value), &self)),
        }
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Value, E> {
        match self.kind {
            Kind::Number => Ok(value.into()),
            Kind::Index | Kind::Size => Err(E::invalid_value(Unexpected::Signed(value), &self)),
            _ => Err(E::invalid_type(Unexpected::Signed(value), &self)),
        }
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Value, E> {
        match (self.kind, integer(value)) {
            (Kind::Number, _) => Ok(Number::from_f64(value).into()),
            (Kind::Index | Kind::Size, Some(value)) => self.visit_u64(value),
            (Kind::Index | Kind::Size, None) => Err(E::invalid_value(Unexpected::Float(value), &self)),
            _ => Err(E::invalid_type(Unexpected::Float(value), &self)),
        }
    }

    fn visit_str<E: Error>(self, value: &str) -> Result<Value, E> {
        match self.kind {
            Kind::Text => Ok(value.into()),
            _ => {
                let start = value.get(..value.floor_char_boundary(64)).unwrap_or_default();
                Err(E::invalid_type(Unexpected::Str(start), &self))
            }
        }
    }

    /// Some exporters write null for absent scalars.
    fn visit_unit<E: Error>(self) -> Result<Value, E> {
        match self.kind {
            Kind::Text | Kind::Number | Kind::Index | Kind::Vector(_) | Kind::List(_, Kind::Number) => Ok(Value::Null),
            _ => Err(E::invalid_type(Unexpected::Unit, &self)),
        }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let (least, most, kind) = match self.kind {
            Kind::Vector(count) => (*count, *count, &Kind::Number),
            Kind::List(max, kind) => (0, *max, *kind),
            _ => return Err(A::Error::invalid_type(Unexpected::Seq, &self)),
        };
        let mut out = Vec::new();
        while let Some(value) =
            list.next_element_seed(Parser { kind, ..self }).map_err(|error| at(out.len(), &error))?
        {
            if out.len() == most {
                return Err(A::Error::custom(format_args!("more than {most} elements")));
            }
            out.push(value);
        }
        if out.len() < least {
            return Err(A::Error::invalid_length(out.len(), &self));
        }
        Ok(out.into())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value, A::Error> {
        let Kind::Object(properties) = self.kind else { return Err(A::Error::invalid_type(Unexpected::Map, &self)) };
        let mut out = Map::new();
        while let Some(property) = map.next_key_seed(PropertyName(properties))? {
            let Some(property) = property else {
                map.next_value::<IgnoredAny>()?;
                continue;
            };
            let name = property.name();
            if out.contains_key(name) {
                return Err(A::Error::duplicate_field(name));
            }
            let parser = Parser { kind: property.kind(), ..self };
            let value = map.next_value_seed(parser).map_err(|error| at(name, &error))?;
            if !value.is_null() {
                out.insert(name.to_owned(), value);
            }
        }
        let missing =
            |property: &&Property| matches!(property, Property::Required(name, _) if !out.contains_key(*name));
        match properties.iter().find(missing) {
            Some(property) => Err(A::Error::missing_field(property.name())),
            None => Ok(out.into()),
        }
    }
}

/// Returns a float's value if it is an integer: JSON may write one as `24.0` or `5.126e3`.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is integral and within range")]
fn integer(value: f64) -> Option<u64> {
    const END: f64 = 18_446_744_073_709_551_616.0;
    ((0.0..END).contains(&value) && value.fract() == 0.0).then_some(value as u64)
}

#[cfg(test)]
mod tests {
    use crate::reader::json::{Document, parse};

    fn with(properties: &str) -> Result<Document, String> {
        parse(format!(r#"{{"asset":{{"version":"2.0"}},{properties}}}"#).as_bytes())
    }

    fn fault(properties: &str) -> String {
        with(properties).err().unwrap_or_else(|| panic!("{properties} is taken"))
    }

    #[test]
    fn faults_name_their_place() {
        for (properties, says) in [
            (r#""nodes":[{},{"mesh":"a"}]"#, "/nodes/1/mesh: invalid type: string \"a\", expected an integer"),
            (r#""nodes":[[]]"#, "/nodes/0: invalid type: sequence, expected an object"),
            (r#""nodes":{}"#, "/nodes: invalid type: map, expected an array of at most 262144 elements"),
            (r#""nodes":null"#, "/nodes: invalid type: null"),
            (r#""nodes":[],"nodes":[]"#, "duplicate field `nodes`"),
            (r#""nodes":[{"mesh":1,"mesh":1}]"#, "/nodes/0: duplicate field `mesh`"),
            (r#""nodes":[{"scale":[1,1]}]"#, "/nodes/0/scale: invalid length 2, expected an array of 3 numbers"),
            (r#""nodes":[{"scale":[1,1,1,1]}]"#, "/nodes/0/scale: more than 3"),
            (r#""nodes":[{"scale":[1,1,1e999]}]"#, "/nodes/0/scale/2: number out of range"),
            (
                r#""nodes":[{"extensions":{"KHR_node_visibility":[]}}]"#,
                "/nodes/0/extensions/KHR_node_visibility: invalid",
            ),
            (r#""buffers":[{}]"#, "/buffers/0: missing field `byteLength`"),
            (r#""accessors":[{"sparse":{"count":1,"indices":[]}}]"#, "/accessors/0/sparse/indices: invalid type"),
            (r#""meshes":[{"primitives":[{}]}]"#, "/meshes/0/primitives/0: missing field `attributes`"),
            (r#""extensions":{"KHR_lights_punctual":{"lights":[{}]}}"#, "/lights/0: missing field `type`"),
            (r#""animations":[[]]"#, "/animations/0: invalid type: sequence"),
            (
                r#""animations":[{"channels":[{"target":{"node":-1}}]}]"#,
                "/animations/0/channels/0/target/node: invalid",
            ),
        ] {
            let fault = fault(properties);
            assert!(fault.contains(says) && fault.contains(" at line 1 column "), "{properties}: {fault}");
        }
    }

    #[test]
    fn integers_may_be_written_as_floats_without_a_fraction() {
        let count =
            |count: &str| with(&format!(r#""accessors":[{{"componentType":5.126e3,"count":{count},"type":"VEC3"}}]"#));
        for (text, value) in [
            ("24.0", 24),
            ("240e-1", 24),
            ("-0.0", 0),
            ("9007199254740992.0", 1 << 53),
            ("1e19", 10_000_000_000_000_000_000),
        ] {
            assert_eq!(count(text).unwrap().json.accessors[0].count.0, value, "{text}");
        }
        for text in ["24.5", "-1", "-1.0", "1e-3", "1e20", "18446744073709551616", "\"24\""] {
            assert!(count(text).err().unwrap().contains("/accessors/0/count: invalid"), "{text}");
        }
        assert_eq!(with(r#""scene":4294967295.0"#).unwrap().json.scene.unwrap().value(), u32::MAX as usize);
        assert!(fault(r#""scene":4294967296.0"#).contains("4294967296"));
    }

    #[test]
    fn unread_properties_may_hold_anything() {
        let properties = r#""extras":7,"extensions":{"NEW_thing":[1]},
            "animations":[{"extras":[],"channels":[{"target":{"extras":1}}]}],
            "nodes":[{"camera":null,"extras":[],"name":null,"extensions":{"NEW_thing":null}}],
            "materials":[{"extensions":{"KHR_materials_unlit":[],"KHR_materials_volume":7}}],
            "samplers":[{"name":1}],"scenes":[{}]"#;
        let document = with(properties).unwrap();
        assert_eq!(document.animations[0].channels.len(), 1);
        assert!(document.materials[0].extensions.unlit && document.json.scenes[0].nodes.is_empty());
    }
}
