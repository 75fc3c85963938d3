//! A file's keys as JSON Schema (2020-12), for editors and for forms.

use serde_json::{Map, Value as Json, json};

use super::{
    page::{Part, Section, sections},
    sources::{Library, Structure, Value},
};

/// A number before a unit.
const NUMBER: &str = r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?";

/// Returns the schema of a file.
pub(super) fn schema(library: &Library, part: &Part<'_>) -> String {
    let sections = sections(library, part);
    let mut definitions = Map::new();
    for section in sections.iter().skip(1) {
        let table = table(library, &sections, section.structure);
        definitions.insert(section.name().to_owned(), table);
    }
    let mut whole = table(library, &sections, part.top);
    let name = part.name.to_lowercase();
    if let Some(top) = whole.as_object_mut() {
        let draft = "https://json-schema.org/draft/2020-12/schema";
        top.insert("$schema".to_owned(), json!(draft));
        top.insert("title".to_owned(), json!(format!("eis-bench: {name}")));
        top.insert("description".to_owned(), json!(part.about));
        top.insert("$defs".to_owned(), Json::Object(definitions));
    }
    serde_json::to_string_pretty(&whole).unwrap() + "\n"
}

fn table(library: &Library, sections: &[Section<'_>], structure: Structure<'_>) -> Json {
    let mut properties = Map::new();
    let mut required = Vec::new();
    for key in library.keys(structure) {
        let reference = |inner: Structure<'_>| {
            let section = sections.iter().find(|one| one.structure.same_as(inner));
            json!({ "$ref": format!("#/$defs/{}", section.unwrap().name()) })
        };
        let mut value = match key.value {
            Value::Plain(plain) => of_words(library, &plain),
            Value::Table(inner) => reference(inner),
            Value::Tables(inner) => json!({ "type": "array", "items": reference(inner) }),
            Value::Words(many, words) => {
                let one = |(word, meaning): &(String, String)| json!({ "const": word, "description": meaning });
                let words: Vec<Json> = words.iter().map(one).collect();
                let choice = json!({ "oneOf": words });
                if many.is_empty() {
                    choice
                } else {
                    json!({ "type": "array", "items": choice })
                }
            }
        };
        let default = key
            .needed
            .strip_prefix('`')
            .and_then(|text| text.strip_suffix('`'));
        if key.needed == "yes" {
            required.push(key.name.clone());
        }
        if let Some(value) = value.as_object_mut() {
            value.insert("description".to_owned(), json!(key.meaning));
            if let Some(default) = default.and_then(|text| serde_json::from_str::<Json>(text).ok())
            {
                value.insert("default".to_owned(), default);
            }
        }
        properties.insert(key.name, value);
    }
    json!({
        "type": "object",
        "description": structure.about(),
        "properties": properties,
        "required": required,
        "additionalProperties": false,
    })
}

/// Returns the schema of a value that a page describes as text.
fn of_words(library: &Library, plain: &str) -> Json {
    let list = |count: &str, items: Json| {
        let mut array = json!({ "type": "array", "items": items });
        if let (Ok(count), Some(array)) = (count.parse::<u64>(), array.as_object_mut()) {
            array.insert("minItems".to_owned(), json!(count));
            array.insert("maxItems".to_owned(), json!(count));
        }
        array
    };
    if let Some((head, each)) = plain.split_once(", each a") {
        let each = each.trim_start_matches('n').trim_start();
        return list(head.trim_start_matches("list of "), of_words(library, each));
    }
    match plain {
        "text" => json!({ "type": "string" }),
        "true or false" => json!({ "type": "boolean" }),
        "number" => json!({ "type": "number" }),
        "whole number" => json!({ "type": "integer", "minimum": 0 }),
        "list of texts" => list("", json!({ "type": "string" })),
        "tables of true or false, numbers or words" => json!({ "type": "object" }),
        other => {
            if let Some(count) = other.strip_prefix("list of ") {
                return list(
                    count.trim_end_matches("numbers").trim(),
                    json!({ "type": "number" }),
                );
            }
            let (name, _) = other.split_once(", such as").unwrap_or((other, ""));
            let quantity = library.quantities.values().find(|quantity| {
                quantity
                    .name
                    .trim_start_matches("an ")
                    .trim_start_matches("a ")
                    == name
            });
            let quantity = quantity.unwrap_or_else(|| panic!("{other}: no type of a schema"));
            let units: Vec<String> = quantity
                .units
                .iter()
                .map(|(unit, _)| unit.clone())
                .collect();
            json!({
                "type": "string",
                "pattern": format!(r"^\s*{NUMBER}\s*({})\s*$", units.join("|")),
                "examples": [quantity.example],
                "x-units": units,
            })
        }
    }
}
