//! Model files follow the schema of `docs/model.schema.json`. Supports only the keywords of JSON
//! Schema that this schema uses.

use serde_json::Value;

use crate::support::{json, program};

/// Deviations of a value from its schema.
fn mistakes(schema: &Value, root: &Value, value: &Value, at: &str) -> Vec<String> {
    let known = [
        "$schema",
        "$defs",
        "title",
        "description",
        "type",
        "required",
        "properties",
        "items",
        "$ref",
        "enum",
        "const",
        "minimum",
        "exclusiveMinimum",
    ];
    let words = schema.as_object().unwrap();
    assert!(
        words.keys().all(|word| known.contains(&word.as_str())),
        "{at}: {words:?}"
    );
    if let Some(name) = schema["$ref"].as_str() {
        return mistakes(
            root.pointer(name.trim_start_matches('#')).unwrap(),
            root,
            value,
            at,
        );
    }
    let mut found = Vec::new();
    let is = |kind: &str| match kind {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "integer" => value.is_u64() || value.is_i64(),
        "number" => value.is_number(),
        "null" => value.is_null(),
        other => panic!("{other}"),
    };
    let kinds: Vec<&str> = schema["type"].as_array().map_or_else(
        || schema["type"].as_str().into_iter().collect(),
        |all| all.iter().filter_map(Value::as_str).collect(),
    );
    if !kinds.is_empty() && !kinds.iter().any(|kind| is(kind)) {
        return vec![format!("{at}: expected {kinds:?}, met {value}")];
    }
    let refused = [
        words.contains_key("const") && schema["const"] != *value,
        schema["enum"]
            .as_array()
            .is_some_and(|all| !all.contains(value)),
        schema["minimum"]
            .as_f64()
            .zip(value.as_f64())
            .is_some_and(|(least, met)| met < least),
        schema["exclusiveMinimum"]
            .as_f64()
            .zip(value.as_f64())
            .is_some_and(|(least, met)| met <= least),
    ];
    if refused.contains(&true) {
        found.push(format!("{at}: met {value}"));
    }
    if let Some(object) = value.as_object() {
        let required = schema["required"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_str);
        found.extend(
            required
                .filter(|name| !object.contains_key(*name))
                .map(|name| format!("{at}: no {name}")),
        );
        for (name, below) in schema["properties"].as_object().into_iter().flatten() {
            found.extend(object.get(name).map_or_else(Vec::new, |value| {
                mistakes(below, root, value, &format!("{at}.{name}"))
            }));
        }
    }
    if let (Some(items), true) = (value.as_array(), words.contains_key("items")) {
        found.extend(
            items.iter().enumerate().flat_map(|(k, item)| {
                mistakes(&schema["items"], root, item, &format!("{at}[{k}]"))
            }),
        );
    }
    found
}

#[test]
fn model_files_follow_their_schema() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let schema = json(format!("{root}/docs/model.schema.json").as_ref());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("fit");
    let spectrum = format!("{root}/fixtures/data/spectra/vendors/impedance_py.csv");
    program(&[
        "fit".as_ref(),
        spectrum.as_ref(),
        "--rc".as_ref(),
        "2".as_ref(),
        "--out".as_ref(),
        out.as_os_str(),
    ])
    .expect_code(0);
    let found = crate::support::files_below(&out)
        .into_iter()
        .find(|file| file.ends_with("model_2rc.json"))
        .unwrap();
    let mut model = json(&out.join(found));
    assert_eq!(mistakes(&schema, &schema, &model, "model"), [""; 0]);
    // Every field of the file is in the schema.
    for name in model.as_object().unwrap().keys() {
        assert!(schema["properties"].get(name).is_some(), "{name}");
    }
    for name in model["fit"].as_object().unwrap().keys() {
        assert!(
            schema["properties"]["fit"]["properties"]
                .get(name)
                .is_some(),
            "fit.{name}"
        );
    }
    model["fit"]["erm"]["branches"][0]["c_f"] = Value::from(-1.0);
    model["rc"] = Value::from("two");
    let message = mistakes(&schema, &schema, &model, "model");
    assert_eq!(
        message,
        [
            "model.fit.erm.branches[0].c_f: met -1.0",
            "model.rc: expected [\"integer\"], met \"two\""
        ]
    );
}

#[test]
fn typed_models_and_ladders_follow_theirs() {
    let root = json(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/model.schema.json").as_ref());
    let schema = &root["$defs"]["typed"];
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let fits = r#"{"fits": [{
        "circuit": "L0-R0-p(R1-Wo1,CPE1)-W2",
        "values": [2e-8, 0.006, 0.002, 0.004, 30, 2, 0.85, 1e-5],
        "band_hz": [0.01, 1000]
    }]}"#;
    std::fs::write(path("circuit.json"), fits).unwrap();
    let out = path("out");
    let convert = |model: &[&std::ffi::OsStr]| {
        program(
            &[
                &["convert".as_ref()],
                model,
                &[
                    "--to".as_ref(),
                    "model".as_ref(),
                    "--out".as_ref(),
                    out.as_os_str(),
                ],
            ]
            .concat(),
        )
        .expect_code(0);
    };
    convert(&["--erm".as_ref(), "6.43 mΩ; 1.51 mΩ, 0.553 F".as_ref()]);
    convert(&[path("circuit.json").as_os_str()]);
    for name in ["typed_model.json", "circuit_model.json"] {
        let mut model = json(&out.join(name));
        assert_eq!(mistakes(schema, &root, &model, "model"), [""; 0]);
        for (of, met) in [
            (&schema["properties"], &model),
            (
                &schema["properties"]["ladder"]["properties"],
                &model["ladder"],
            ),
        ] {
            met.as_object()
                .into_iter()
                .flatten()
                .for_each(|(field, _)| assert!(of.get(field).is_some(), "{field}"));
        }
        model["branches"][0]["c_f"] = Value::from(0.0);
        assert_eq!(
            mistakes(schema, &root, &model, "model"),
            ["model.branches[0].c_f: met 0.0"]
        );
    }
}
