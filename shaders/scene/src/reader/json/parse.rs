//! How JSON is taken apart: objects only where objects are due, lists only as long as `limits` allow, long strings not
//! copied.

use std::{borrow::Cow, fmt, marker::PhantomData};

use serde::{
    Deserialize, Deserializer,
    de::{DeserializeSeed, Error, MapAccess, SeqAccess, Visitor, value::MapAccessDeserializer},
};

use crate::limits::MAX_EXTENSIONS;

/// A string that is borrowed from the JSON where it has no escapes: a data URI is not copied. (serde's own `Cow` inside
/// an `Option` always copies.)
pub(crate) struct Text<'a>(pub(crate) Cow<'a, str>);

impl<'de: 'a, 'a> Deserialize<'de> for Text<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct TextVisitor;
        impl<'de> Visitor<'de> for TextVisitor {
            type Value = Text<'de>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a string")
            }
            fn visit_borrowed_str<E: Error>(self, text: &'de str) -> Result<Self::Value, E> {
                Ok(Text(Cow::Borrowed(text)))
            }
            fn visit_str<E: Error>(self, text: &str) -> Result<Self::Value, E> {
                Ok(Text(Cow::Owned(text.to_owned())))
            }
        }
        deserializer.deserialize_str(TextVisitor)
    }
}

/// A JSON object as `T`. serde's derived structs take arrays too; glTF does not.
struct Object<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> DeserializeSeed<'de> for Object<T> {
    type Value = T;
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<T, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de, T: Deserialize<'de>> Visitor<'de> for Object<T> {
    type Value = T;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }
    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<T, A::Error> {
        T::deserialize(MapAccessDeserializer::new(map))
    }
}

/// A JSON object as `T`.
pub(crate) fn object<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<T, D::Error> {
    Object(PhantomData).deserialize(deserializer)
}

/// An optional property's object, as serde's `default` leaves it out.
pub(crate) fn optional<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    object(deserializer).map(Some)
}

/// A list of at most `MAX` objects: a longer one is an error while it is parsed, before it takes memory.
pub(crate) fn list<'de, D: Deserializer<'de>, T: Deserialize<'de>, const MAX: usize>(
    deserializer: D,
) -> Result<Vec<T>, D::Error> {
    struct ListVisitor<T, const MAX: usize>(PhantomData<T>);
    impl<'de, T: Deserialize<'de>, const MAX: usize> Visitor<'de> for ListVisitor<T, MAX> {
        type Value = Vec<T>;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "an array of at most {MAX} objects")
        }
        fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Vec<T>, A::Error> {
            let mut out = Vec::new();
            while let Some(element) = elements.next_element_seed(Object(PhantomData))? {
                if out.len() == MAX {
                    return Err(A::Error::custom(format_args!("more than {MAX} elements")));
                }
                out.push(element);
            }
            Ok(out)
        }
    }
    deserializer.deserialize_seq(ListVisitor::<T, MAX>(PhantomData))
}

/// A list of at most [`MAX_EXTENSIONS`] names.
pub(crate) fn strings<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    struct StringsVisitor;
    impl<'de> Visitor<'de> for StringsVisitor {
        type Value = Vec<String>;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "an array of at most {MAX_EXTENSIONS} strings")
        }
        fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Self::Value, A::Error> {
            let mut out = Vec::new();
            while let Some(name) = elements.next_element()? {
                if out.len() == MAX_EXTENSIONS {
                    return Err(A::Error::custom(format_args!("more than {MAX_EXTENSIONS} extensions")));
                }
                out.push(name);
            }
            Ok(out)
        }
    }
    deserializer.deserialize_seq(StringsVisitor)
}

/// How many objects a list has, none of which is kept.
pub(crate) fn count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<usize, D::Error> {
    struct CountVisitor;
    impl<'de> Visitor<'de> for CountVisitor {
        type Value = usize;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("an array of objects")
        }
        fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<usize, A::Error> {
            let mut count = 0;
            while elements.next_element_seed(Object::<IgnoredObject>(PhantomData))?.is_some() {
                count += 1;
            }
            Ok(count)
        }
    }
    deserializer.deserialize_seq(CountVisitor)
}

/// An object of which nothing is read.
#[derive(Deserialize)]
struct IgnoredObject {}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize, PartialEq)]
    struct Thing {
        #[serde(default)]
        a: u32,
    }

    #[derive(Debug, Deserialize)]
    struct Things {
        #[serde(deserialize_with = "list::<_, _, 2>")]
        things: Vec<Thing>,
    }

    fn things(json: &str) -> Result<Vec<Thing>, String> {
        serde_json::from_str::<Things>(json).map(|things| things.things).map_err(|error| error.to_string())
    }

    #[test]
    fn lists_hold_objects_only_and_not_too_many() {
        assert_eq!(things(r#"{"things":[{},{"a":7}]}"#), Ok(vec![Thing { a: 0 }, Thing { a: 7 }]));
        assert!(things(r#"{"things":[{},{},{}]}"#).unwrap_err().contains("more than 2"));
        assert!(things(r#"{"things":[[]]}"#).unwrap_err().contains("expected an object"));
        assert!(things(r#"{"things":{}}"#).unwrap_err().contains("array"));
        assert!(things(r#"{"things":null}"#).is_err());
        assert!(things(r#"{"things":[{"a":4294967296}]}"#).is_err());
    }

    #[test]
    fn plain_strings_are_borrowed() {
        let text = |json| serde_json::from_str::<Text<'_>>(json).unwrap().0;
        assert!(matches!(text(r#""data:""#), Cow::Borrowed("data:")));
        assert!(matches!(text(r#""a\u0020b""#), Cow::Owned(text) if text == "a b"));
    }
}
