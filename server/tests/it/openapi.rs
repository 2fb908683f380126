use crate::harness::{BOX, Server, harmless};
use crate::schema::misfit;
use serde_json::{Value, json};
use std::collections::BTreeSet;

fn document() -> Value {
    serde_json::to_value(lumicast::http::document()).unwrap()
}

fn schema(name: &str) -> Value {
    json!({"$ref": format!("#/components/schemas/{name}")})
}

/// The document is committed, so that a change of the interface shows in review.
#[test]
fn the_committed_document_is_the_served_one() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.json");
    let text = lumicast::http::document().to_pretty_json().unwrap() + "\n";
    if std::env::var_os("LUMICAST_BLESS").is_some() {
        std::fs::write(path, &text).unwrap();
    }
    assert!(std::fs::read_to_string(path).unwrap() == text, "LUMICAST_BLESS=1 rewrites {path}");
}

/// Every endpoint of the contract is in the document, and nothing else.
#[test]
fn the_document_lists_the_contract() {
    let document = document();
    let mut listed = BTreeSet::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for method in ["get", "post", "delete", "put", "patch"] {
            if item.get(method).is_some() {
                listed.insert(format!("{method} {path}"));
            }
        }
    }
    let expected = [
        "get /",
        "get /healthz",
        "get /metrics",
        "get /readyz",
        "get /v1/scenes",
        "post /v1/scenes",
        "get /v1/scenes/{id}",
        "delete /v1/scenes/{id}",
        "get /v1/scenes/{id}/convergence",
        "get /v1/scenes/{id}/edits",
        "post /v1/scenes/{id}/edits",
        "get /v1/scenes/{id}/effects",
        "get /v1/scenes/{id}/events",
        "get /v1/scenes/{id}/export.glb",
        "get /v1/scenes/{id}/frame",
        "get /v1/scenes/{id}/ws",
    ];
    assert_eq!(listed, expected.iter().map(|s| s.to_string()).collect());
}

/// Every reference leads somewhere.
#[test]
fn the_document_holds_together() {
    fn walk(document: &Value, value: &Value) {
        if let Some(path) = value.get("$ref").and_then(Value::as_str) {
            assert!(document.pointer(&path[1..]).is_some(), "{path}");
        }
        match value {
            Value::Array(items) => items.iter().for_each(|item| walk(document, item)),
            Value::Object(fields) => fields.values().for_each(|item| walk(document, item)),
            _ => {}
        }
    }
    let document = document();
    walk(&document, &document);
}

/// The examples of the protocol document fit the schemas: both describe one interface.
#[test]
fn the_examples_of_the_protocol_document_fit() {
    let document = document();
    let readme =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../protocol/README.md")).unwrap();
    let schema_of = [
        ("scenes", "SceneList"),
        ("edit", "Edit"),
        ("batch", "EditBatch"),
        ("reply", "EditReply"),
        ("log", "EventLog"),
        ("problem", "Problem"),
        ("effects", "Effects"),
        ("convergence", "Convergence"),
        ("environment", "EnvironmentDescription"),
    ];
    let mut seen = BTreeSet::new();
    for block in readme.split("```json ").skip(1) {
        let (kind, rest) = block.split_once('\n').unwrap();
        let example: Value = serde_json::from_str(rest.split("```").next().unwrap()).unwrap();
        if let Some((_, name)) = schema_of.iter().find(|(known, _)| *known == kind.trim()) {
            assert_eq!(misfit(&document, &schema(name), &example), None, "{example}");
            seen.insert(*name);
        } else if example["type"] == "scene" {
            assert_eq!(misfit(&document, &schema("SceneDescription"), &example["scene"]), None);
        }
    }
    assert_eq!(seen.len(), schema_of.len(), "{seen:?}");
}

/// What the server really answers fits what the document says.
#[tokio::test]
async fn real_answers_fit_the_document() {
    let server = Server::start(|_| {}).await;
    let served = server.get("/openapi.json").await;
    assert_eq!(served.json(), document());
    server.edit(harmless(0.1)).await.revision();
    let document = document();
    for (path, name) in [
        ("/v1/scenes".to_string(), "SceneList"),
        (BOX.to_string(), "SceneDescription"),
        (format!("{BOX}/edits?since=1"), "EventLog"),
        (format!("{BOX}/effects"), "Effects"),
        (format!("{BOX}/convergence"), "Convergence"),
        ("/nothing".to_string(), "Problem"),
    ] {
        let answer = server.get(&path).await.json();
        assert_eq!(misfit(&document, &schema(name), &answer), None, "{path}: {answer}");
    }
    server.stop().await;
}
