//! The few words of JSON Schema that the OpenAPI document uses, for holding values against it.

use serde_json::Value;

/// Why a value does not fit a schema; `None` where it does.
pub(crate) fn misfit(document: &Value, schema: &Value, value: &Value) -> Option<String> {
    if let Some(path) = schema["$ref"].as_str() {
        let pointer = path.strip_prefix('#').unwrap();
        let target = document.pointer(pointer).unwrap_or_else(|| panic!("{path} leads nowhere"));
        return misfit(document, target, value);
    }
    if let Some(choices) = schema["oneOf"].as_array() {
        let reasons: Vec<String> =
            choices.iter().filter_map(|choice| misfit(document, choice, value)).collect();
        return (reasons.len() == choices.len()).then(|| reasons.join(" | "));
    }
    if let Some(allowed) = schema["enum"].as_array()
        && !allowed.contains(value)
    {
        return Some(format!("{value} is none of {allowed:?}"));
    }
    let type_fits = match schema["type"].as_str().unwrap() {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "string" => value.is_string(),
        "number" => value.is_number(),
        "integer" => value.is_u64() || value.is_i64(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        other => panic!("type {other} is not known here"),
    };
    if !type_fits {
        return Some(format!("{value} is no {}", schema["type"]));
    }
    number_misfit(schema, value)
        .or_else(|| array_misfit(document, schema, value))
        .or_else(|| object_misfit(document, schema, value))
}

fn number_misfit(schema: &Value, value: &Value) -> Option<String> {
    let number = value.as_f64()?;
    let below = schema["minimum"].as_f64().is_some_and(|minimum| number < minimum);
    let above = schema["maximum"].as_f64().is_some_and(|maximum| number > maximum);
    (below || above).then(|| format!("{number} is out of range"))
}

fn array_misfit(document: &Value, schema: &Value, value: &Value) -> Option<String> {
    let items = value.as_array()?;
    let length = items.len() as u64;
    if schema["minItems"].as_u64().is_some_and(|n| length < n)
        || schema["maxItems"].as_u64().is_some_and(|n| length > n)
    {
        return Some(format!("{length} items"));
    }
    items.iter().find_map(|item| misfit(document, &schema["items"], item))
}

fn object_misfit(document: &Value, schema: &Value, value: &Value) -> Option<String> {
    let fields = value.as_object()?;
    let required = schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str);
    if let Some(missing) = required.into_iter().find(|name| !fields.contains_key(*name)) {
        return Some(format!("{missing} is missing"));
    }
    fields.iter().find_map(|(name, value)| match schema["properties"].get(name) {
        Some(schema) => misfit(document, schema, value).map(|reason| format!("{name}: {reason}")),
        None => Some(format!("{name} is not in the document")),
    })
}
