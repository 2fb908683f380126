//! The protocol document cannot go stale: every example in `README.md` is read and written by the types, and every
//! op, problem, limit and header field stands in it.

#![allow(clippy::unwrap_used, reason = "the helpers of a test may fail loudly")]

use lumicast_protocol::*;
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;

const README: &str = include_str!("../README.md");

/// Marked code blocks: what follows "```json " on the first line, and the text.
fn examples() -> Vec<(&'static str, &'static str)> {
    README
        .split("\n```json ")
        .skip(1)
        .map(|block| {
            let (mark, rest) = block.split_once('\n').unwrap();
            (mark, rest.split_once("\n```").unwrap().0)
        })
        .collect()
}

/// Reads an example as a `T`, writes it, and expects everything that stood in the example to stand there again:
/// a field that the types do not know, or know by another name or unit, does not survive that.
fn survives<T: Serialize + DeserializeOwned>(json: &str) {
    let value: T = serde_json::from_str(json).unwrap_or_else(|error| panic!("{error} in\n{json}"));
    // Through text, because `to_value` turns the f32 0.7 into the f64 0.699999988.
    let written: Value = serde_json::from_str(&serde_json::to_string(&value).unwrap()).unwrap();
    let read: Value = serde_json::from_str(json).unwrap();
    // A bare array of edits is written as a batch.
    let written = if read.is_array() { written["edits"].clone() } else { written };
    assert_contains(&written, &read, json);
}

fn assert_contains(written: &Value, example: &Value, json: &str) {
    match (written, example) {
        (Value::Object(written), Value::Object(example)) => {
            for (key, value) in example {
                let there = written.get(key).unwrap_or_else(|| panic!("`{key}` is lost from\n{json}"));
                assert_contains(there, value, json);
            }
        }
        (Value::Array(written), Value::Array(example)) => {
            assert_eq!(written.len(), example.len(), "{json}");
            written.iter().zip(example).for_each(|(w, e)| assert_contains(w, e, json));
        }
        (Value::Number(written), Value::Number(example)) => {
            assert_eq!(written.as_f64(), example.as_f64(), "{json}");
        }
        _ => assert_eq!(written, example, "{json}"),
    }
}

#[test]
fn every_example_in_the_document_is_read_and_written_by_the_types() {
    for (mark, json) in examples() {
        match mark {
            "client" => survives::<ClientMessage>(json),
            "server" => survives::<ServerMessage>(json),
            "edit" => survives::<Edit>(json),
            "batch" => survives::<EditBatch>(json),
            "reply" => survives::<EditReply>(json),
            "log" => survives::<EventLog>(json),
            "problem" => survives::<Problem>(json),
            "scenes" => survives::<SceneList>(json),
            "environment" => survives::<EnvironmentDescription>(json),
            "effects" => survives::<Effects>(json),
            "convergence" => survives::<Convergence>(json),
            other => panic!("no type is known for examples marked {other:?}"),
        }
    }
}

#[test]
fn every_op_and_every_message_has_an_example() {
    let names = |mark: &str, key: &str| -> Vec<String> {
        let of_mark = examples().into_iter().filter(|(m, _)| *m == mark);
        of_mark
            .map(|(_, json)| serde_json::from_str::<Value>(json).unwrap()[key].as_str().unwrap().into())
            .collect()
    };
    for op in Edit::OPS {
        assert!(names("edit", "op").iter().any(|name| name == op), "no example of {op}");
    }
    for (_, json) in examples().into_iter().filter(|(mark, _)| *mark == "edit") {
        let edit: Edit = serde_json::from_str(json).unwrap();
        let value: Value = serde_json::from_str(json).unwrap();
        assert_eq!(value["op"], edit.op_name());
    }
    for name in ["hello", "camera", "quality", "accuracy", "edit", "ack", "ping"] {
        assert!(names("client", "type").iter().any(|n| n == name), "no example of {name}");
    }
    for name in ["hello", "scene", "edited", "error", "stats", "pong"] {
        assert!(names("server", "type").iter().any(|n| n == name), "no example of {name}");
    }
}

#[test]
fn the_defaults_in_the_document_are_the_defaults() {
    let quality = ClientMessage::Quality(Quality::default());
    let accuracy = ClientMessage::Accuracy(Accuracy { bounces: Some(16), ..Accuracy::default() });
    let shown: Vec<_> = examples()
        .into_iter()
        .filter(|(mark, _)| *mark == "client")
        .map(|(_, json)| ClientMessage::from_json(json).unwrap())
        .collect();
    assert!(shown.contains(&quality) && shown.contains(&accuracy));
    for (limit, default) in serde_json::to_value(Limits::default()).unwrap().as_object().unwrap() {
        assert!(README.contains(&format!("\n| `{limit}` | {default} |")), "limit {limit} = {default}");
    }
    let limits = serde_json::from_str::<Value>(
        examples().iter().find(|(_, json)| json.contains("\"limits\"")).unwrap().1,
    );
    assert_eq!(
        serde_json::from_value::<Limits>(limits.unwrap()["limits"].clone()).unwrap(),
        Limits::default()
    );
}

#[test]
fn every_problem_and_every_header_field_stands_in_the_document() {
    for kind in ProblemKind::ALL {
        let row = format!("\n| `{}` | {} |", kind.uri(), kind.status());
        assert!(README.contains(&row), "{row}");
    }
    for example in examples().iter().filter(|(mark, _)| *mark == "problem") {
        let problem: Problem = serde_json::from_str(example.1).unwrap();
        assert!(ProblemKind::ALL.iter().any(|k| problem.is(*k) && k.title() == problem.title), "{problem:?}");
    }
    let rows = include_str!("../src/frame.rs").lines().filter_map(|line| line.strip_prefix("//! | "));
    for row in rows.filter(|row| row.starts_with(|c: char| c.is_ascii_digit())) {
        let mut cells = row.split(" | ");
        let start = format!("\n| {} | {} | ", cells.next().unwrap(), cells.next().unwrap());
        assert!(README.contains(&start), "{start}");
    }
}

#[test]
fn what_a_server_does_not_know_it_refuses_and_a_client_ignores() {
    for json in [
        r#"{"type":"hello","client":"a","version":"1","more":1}"#,
        r#"{"type":"ack","frame":1,"more":1}"#,
        r#"{"type":"camera","stamp":1,"size":[1,1],"camera":"c","more":1}"#,
        r#"{"type":"camera","stamp":1,"size":[1,1]}"#,
        r#"{"type":"quality","gamma":2.2}"#,
        r#"{"type":"dance"}"#,
        r#"{"stamp":1}"#,
    ] {
        assert!(ClientMessage::from_json(json).is_err(), "{json}");
    }
    for (_, json) in examples().into_iter().filter(|(mark, _)| *mark == "edit") {
        let with_more = json.replacen('{', r#"{"more":1,"#, 1);
        assert!(serde_json::from_str::<Edit>(&with_more).is_err(), "{with_more}");
    }
    assert!(ServerMessage::from_json(r#"{"type":"pong","stamp":1,"more":1}"#).is_ok());
}

#[test]
fn absent_and_null_differ_where_null_means_something() {
    let parse = |json: &str| match serde_json::from_str(json).unwrap() {
        Edit::SetMaterial(edit) => *edit,
        other => panic!("{other:?}"),
    };
    let before = MaterialProperties { alpha_cutoff: Some(0.5), ..MaterialProperties::default() };
    let absent = parse(r#"{"op":"set_material","material":"m","metallic":1}"#);
    assert_eq!(absent.applied_to(&before), MaterialProperties { metallic: 1.0, ..before });
    let null = parse(r#"{"op":"set_material","material":"m","alpha_cutoff":null}"#);
    assert_eq!(null.alpha_cutoff, Change::Clear);
    assert_eq!(null.applied_to(&before).alpha_cutoff, None);
    assert_eq!(parse(&serde_json::to_string(&Edit::SetMaterial(Box::new(null.clone()))).unwrap()), null);
}

#[test]
fn an_environment_picture_has_twelve_bytes_a_texel() {
    let image = |json: &str| match serde_json::from_str(json).unwrap() {
        Edit::SetEnvironment(SetEnvironment::Image { image, .. }) => image,
        other => panic!("{other:?}"),
    };
    let (_, json) = *examples().iter().find(|(_, json)| json.contains("texels\": \"")).unwrap();
    let good = image(json);
    assert_eq!(good.radiance(), Some(vec![[1.0, 1.0, 1.0], [0.5, 0.25, 0.125]]));
    assert_eq!(EnvironmentImage { width: 3, ..good.clone() }.radiance(), None);
    assert_eq!(EnvironmentImage { width: u32::MAX, height: u32::MAX, ..good }.radiance(), None);
}
