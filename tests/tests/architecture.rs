//! The walls of the house, by machine: which crate may need which, which room of the engine may import which, and
//! what the engine never names. `layout.md` and `CONTRIBUTING.md` say why.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Rooms of the engine: each may import those before it and none after.
const ROOMS: [&str; 9] =
    ["math", "scene", "accel", "transport", "film", "gpu", "technique", "effects", "render"];

/// Arrows between crates: the first may need the second. `lumicast-tests` may see all.
const ARROWS: [(&str, &str); 4] = [
    ("lumicast-viewer", "lumicast-protocol"),
    ("lumicast", "lumicast-protocol"),
    ("lumicast", "lumicast-engine"),
    ("lumicast-engine", "lumicast-shaders"),
];

#[test]
fn crates_need_only_what_the_layout_allows() {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
        .current_dir(workspace())
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata = serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON");
    let found = arrows(&metadata);
    assert!(found.len() >= 4, "the reader of cargo metadata sees too little: {found:?}");
    assert_eq!(forbidden_arrows(&found), Vec::<String>::new());
}

#[test]
fn rooms_of_the_engine_import_to_the_left_only() {
    let sources = engine_sources();
    assert!(sources.len() > 20, "the engine has more files than {}", sources.len());
    let room_imports = sources
        .iter()
        .flat_map(imports)
        .filter(|import| import.path.first().is_some_and(|room| is_room(room)));
    assert!(room_imports.count() > 20, "the reader of `use` lines sees too little");
    assert_eq!(violations(&sources), Vec::<String>::new());
}

// ---- crates ----

/// (who, needs whom) among the crates of the workspace, of every kind of dependency.
fn arrows(metadata: &serde_json::Value) -> Vec<(String, String)> {
    let packages = metadata["packages"].as_array().expect("packages");
    let name_of = |value: &serde_json::Value| value["name"].as_str().expect("a name").to_string();
    let ours: BTreeSet<String> = packages.iter().map(name_of).collect();
    let needs = |package: &serde_json::Value| {
        let needed = package["dependencies"].as_array().expect("dependencies").iter().map(name_of);
        let who = name_of(package);
        needed.map(move |whom| (who.clone(), whom)).collect::<Vec<_>>()
    };
    packages.iter().flat_map(needs).filter(|(_, whom)| ours.contains(whom)).collect()
}

fn forbidden_arrows(arrows: &[(String, String)]) -> Vec<String> {
    arrows
        .iter()
        .filter(|(who, whom)| who != "lumicast-tests" && !ARROWS.contains(&(who.as_str(), whom.as_str())))
        .map(|(who, whom)| format!("{who} must not need {whom}"))
        .collect()
}

#[test]
fn the_check_of_crates_can_fail() {
    let metadata = |who: &str, whom: &str| {
        serde_json::json!({"packages": [
            {"name": who, "dependencies": [{"name": whom, "kind": "dev"}, {"name": "serde"}]},
            {"name": whom, "dependencies": []},
        ]})
    };
    let check = |who, whom| forbidden_arrows(&arrows(&metadata(who, whom)));
    assert_eq!(
        check("lumicast-viewer", "lumicast-engine"),
        ["lumicast-viewer must not need lumicast-engine"]
    );
    assert_eq!(check("lumicast-engine", "lumicast-protocol").len(), 1);
    assert_eq!(check("lumicast-protocol", "lumicast").len(), 1);
    assert!(check("lumicast", "lumicast-engine").is_empty());
    assert!(check("lumicast-tests", "lumicast-viewer").is_empty());
}

// ---- rooms ----

/// A file of a crate: `module` is its place, `["film", "tile"]` for `film/tile.rs`.
struct Source {
    module: Vec<String>,
    tokens: Vec<String>,
}

/// A path that a file names, from the root of the crate (`["math", "Rgb"]`) or of another (`["std", "fs"]`).
#[derive(Debug, PartialEq)]
struct Import {
    foreign: bool,
    path: Vec<String>,
}

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn engine_sources() -> Vec<Source> {
    let root = workspace().join("server/engine/src");
    let mut sources = Vec::new();
    let mut test_modules = BTreeSet::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of the engine") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = std::fs::read_to_string(&path).expect("UTF-8");
                let module = module_of(path.strip_prefix(&root).expect("below the root"));
                let (source, tests) = source(module, &text);
                test_modules.extend(tests);
                sources.push(source);
            }
        }
    }
    // Files of modules that are for tests only.
    sources.retain(|source| !test_modules.iter().any(|test| source.module.starts_with(test)));
    sources
}

fn module_of(file: &Path) -> Vec<String> {
    let mut module: Vec<String> =
        file.with_extension("").iter().map(|part| part.to_string_lossy().into_owned()).collect();
    if matches!(module.last().map(String::as_str), Some("mod" | "lib")) {
        module.pop();
    }
    module
}

/// The file without its test code, and the modules that it declares for tests only.
fn source(module: Vec<String>, text: &str) -> (Source, Vec<Vec<String>>) {
    let (tokens, tests) = without_tests(tokens_of(text));
    let tests = tests.into_iter().map(|name| [module.as_slice(), &[name]].concat()).collect();
    (Source { module, tokens }, tests)
}

fn is_room(name: &str) -> bool {
    ROOMS.contains(&name)
}

/// Every broken rule in these files, as a sentence.
fn violations(sources: &[Source]) -> Vec<String> {
    let techniques: BTreeSet<&String> = sources
        .iter()
        .filter(|source| source.module.first().is_some_and(|room| room == "technique"))
        .filter_map(|source| source.module.get(1))
        .collect();
    let place = |name: &str| ROOMS.iter().position(|room| *room == name);
    let mut found = Vec::new();
    for source in sources {
        let who = source.module.join("/");
        for import in imports(source) {
            let path = import.path.join("::");
            if import.foreign {
                if matches!(import.path[0].as_str(), "tokio" | "axum")
                    || path.starts_with("std::net")
                    || path.starts_with("std::fs")
                {
                    found.push(format!("{who} names {path}: the engine knows no network, async or files"));
                }
                let knows_wgpu = source.module.first().is_some_and(|room| room == "gpu")
                    || source.module.last().is_some_and(|file| file == "gpu");
                if import.path[0] == "wgpu" && !knows_wgpu {
                    found.push(format!("{who} names {path}: only the room gpu and the rooms' gpu.rs do"));
                }
                continue;
            }
            let own = source.module.first().and_then(|room| place(room));
            let other = import.path.first().and_then(|room| place(room));
            if let (Some(own), Some(other)) = (own, other)
                && other > own
            {
                found.push(format!("{who} imports {path}, to the right of {}", ROOMS[own]));
            }
            if import.path.first().is_some_and(|room| room == "technique")
                && let (Some(own), Some(other)) = (source.module.get(1), import.path.get(1))
                && source.module[0] == "technique"
                && own != other
                && techniques.contains(other)
            {
                found.push(format!("{who} imports {path}: techniques share through Products only"));
            }
        }
    }
    found
}

/// Paths that start with `crate`, `super`, `std`, `tokio`, `axum` or `wgpu`, in `use` lines and elsewhere.
fn imports(source: &Source) -> Vec<Import> {
    let tokens = &source.tokens;
    let mut found = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        let is_start = matches!(tokens[at].as_str(), "crate" | "super" | "std" | "tokio" | "axum" | "wgpu")
            && tokens.get(at + 1).is_some_and(|next| next == "::")
            // Not the middle of a longer path, as in `self::super`, which is looked at from its start.
            && (at == 0 || tokens[at - 1] != "::");
        if !is_start {
            at += 1;
            continue;
        }
        let mut paths = Vec::new();
        at = read_tree(tokens, at, &[], &mut paths);
        found.extend(paths.into_iter().filter_map(|path| resolved(&source.module, path)));
    }
    found
}

/// Reads one tree of a `use` (`a::{b, c::d}`) and adds its paths; returns the place after it.
fn read_tree(tokens: &[String], mut at: usize, prefix: &[String], paths: &mut Vec<Vec<String>>) -> usize {
    let mut path = prefix.to_vec();
    loop {
        match tokens.get(at).map(String::as_str) {
            Some("{") => {
                at += 1;
                while tokens.get(at).is_some_and(|token| token != "}") {
                    at = if tokens[at] == "," { at + 1 } else { read_tree(tokens, at, &path, paths) };
                }
                return at + 1;
            }
            Some(segment) if is_word(segment) || segment == "*" => path.push(segment.to_string()),
            _ => break,
        }
        at += 1;
        match tokens.get(at).map(String::as_str) {
            Some("::")
                if tokens.get(at + 1).is_some_and(|next| is_word(next) || next == "{" || next == "*") =>
            {
                at += 1;
            }
            Some("as") => {
                at += 2;
                break;
            }
            _ => break,
        }
    }
    paths.push(path);
    // Something unknown (a macro's `$name`) must not stop the reader; signs that end a path are the caller's.
    at + usize::from(at < tokens.len() && !matches!(tokens[at].as_str(), "}" | "," | ";"))
}

fn is_word(token: &str) -> bool {
    token.starts_with(|first: char| first.is_alphabetic() || first == '_')
}

/// The path from the root: `super` leads to the parent of the module, `crate` to the root.
fn resolved(module: &[String], path: Vec<String>) -> Option<Import> {
    let supers = path.iter().take_while(|segment| *segment == "super").count();
    if supers > 0 {
        // More of them than there are parents happens inside an inline module; it stays inside the room then.
        let parents = module.len().checked_sub(supers)?;
        return Some(Import { foreign: false, path: [&module[..parents], &path[supers..]].concat() });
    }
    let foreign = path[0] != "crate";
    Some(Import { foreign, path: if foreign { path } else { path[1..].to_vec() } })
}

/// Leaves out what stands behind `#[cfg(test)]`; the names are those of modules in files of their own.
fn without_tests(tokens: Vec<String>) -> (Vec<String>, Vec<String>) {
    let mark = ["#", "[", "cfg", "(", "test", ")", "]"];
    let (mut kept, mut modules, mut at) = (Vec::new(), Vec::new(), 0);
    while at < tokens.len() {
        if !tokens[at..].iter().take(mark.len()).eq(mark) {
            kept.push(tokens[at].clone());
            at += 1;
            continue;
        }
        at += mark.len();
        let end = end_of_item(&tokens, at);
        if let Some(name) = tokens[at..end].iter().skip_while(|token| *token != "mod").nth(1)
            && tokens[end - 1] == ";"
        {
            modules.push(name.clone());
        }
        at = end;
    }
    (kept, modules)
}

/// The place after the item that begins at `at`: after its `;`, or after its braces.
fn end_of_item(tokens: &[String], mut at: usize) -> usize {
    let mut depth = 0_i32;
    let is_use = tokens[at..].iter().take(4).any(|token| token == "use");
    while at < tokens.len() {
        match tokens[at].as_str() {
            "{" | "(" | "[" => depth += 1,
            "}" | ")" | "]" => depth -= 1,
            _ => {}
        }
        at += 1;
        let last = tokens[at - 1].as_str();
        if depth == 0 && (last == ";" || (last == "}" && !is_use)) {
            break;
        }
    }
    at
}

/// Words, `::` and single signs; comments, texts and characters are left out.
fn tokens_of(text: &str) -> Vec<String> {
    let chars: Vec<char> = text.chars().collect();
    let at_text =
        |at: usize, what: &str| what.chars().enumerate().all(|(i, c)| chars.get(at + i) == Some(&c));
    let (mut tokens, mut at) = (Vec::new(), 0);
    while at < chars.len() {
        let start = at;
        if at_text(at, "//") {
            while at < chars.len() && chars[at] != '\n' {
                at += 1;
            }
        } else if at_text(at, "/*") {
            at += 2;
            let mut depth = 1;
            while at < chars.len() && depth > 0 {
                let (opens, closes) = (at_text(at, "/*"), at_text(at, "*/"));
                depth = depth + i32::from(opens) - i32::from(closes);
                at += if opens || closes { 2 } else { 1 };
            }
        } else if let Some(hashes) = raw_text_at(&chars, at) {
            let end = format!("\"{}", "#".repeat(hashes));
            at += hashes + 2;
            while at < chars.len() && !at_text(at, &end) {
                at += 1;
            }
            at += end.len();
        } else if chars[at] == '"' {
            at = after_quoted(&chars, at, '"');
        } else if chars[at] == '\'' && (chars.get(at + 1) == Some(&'\\') || chars.get(at + 2) == Some(&'\''))
        {
            at = after_quoted(&chars, at, '\'');
        } else if chars[at].is_alphabetic() || chars[at] == '_' {
            while at < chars.len() && (chars[at].is_alphanumeric() || chars[at] == '_') {
                at += 1;
            }
            tokens.push(chars[start..at].iter().collect());
        } else {
            at += if at_text(at, "::") { 2 } else { 1 };
            if !chars[start].is_whitespace() {
                tokens.push(chars[start..at].iter().collect());
            }
        }
    }
    tokens
}

/// Number of `#` of the raw text that begins here.
fn raw_text_at(chars: &[char], at: usize) -> Option<usize> {
    let starts_word = at > 0 && (chars[at - 1].is_alphanumeric() || chars[at - 1] == '_');
    if chars[at] != 'r' || (starts_word && chars[at - 1] != 'b') {
        return None;
    }
    let hashes = chars[at + 1..].iter().take_while(|c| **c == '#').count();
    (chars.get(at + 1 + hashes) == Some(&'"')).then_some(hashes)
}

fn after_quoted(chars: &[char], mut at: usize, quote: char) -> usize {
    at += 1;
    while at < chars.len() && chars[at] != quote {
        at += if chars[at] == '\\' { 2 } else { 1 };
    }
    at + 1
}

// ---- the check itself ----

/// What the checker says about one file, `technique/path` and `technique/octree` being there too.
fn said_of(module: &str, text: &str) -> Vec<String> {
    let parts = |module: &str| module.split('/').map(String::from).collect::<Vec<_>>();
    let sources = [
        source(parts(module), text).0,
        source(parts("technique/path"), "").0,
        source(parts("technique/octree"), "").0,
    ];
    violations(&sources)
}

#[test]
fn an_import_to_the_right_is_found_in_every_way_of_writing_it() {
    for text in [
        "use crate::film::Film;",
        "use crate::{math::Rgb, film::{Film, Tile}};",
        "use crate::{\n    math::{Rgb, warp},\n    render,\n};",
        "use super::super::film::Film;",
        "fn f(film: &crate::film::Film) {}",
        "fn f() { crate::film::compare::<f32>(1); }",
        "pub use crate::film as picture;",
        "use crate::math::*; use crate::film::*;",
        "const C: char = '\"'; use crate::film::Film; // \"",
    ] {
        let said = said_of("scene/light", text);
        assert_eq!(said.len(), 1 + usize::from(text.contains("Tile")), "{text}: {said:?}");
        assert!(said[0].starts_with("scene/light imports "), "{said:?}");
    }
}

#[test]
fn an_import_to_the_left_or_in_tests_or_in_words_is_allowed() {
    for text in [
        "use crate::{math::Rgb, scene::Scene, film::Film};",
        "use super::PictureSize;",
        "// use crate::render::Rendering;",
        "/* use crate::render; /* nested */ use crate::render; */",
        "const S: &str = \"crate::render::Rendering\"; const R: &str = r#\"crate::render \" \"#;",
        "#[cfg(test)]\nmod tests { use crate::render::Rendering; fn f() { {} } }",
        "#[cfg(test)] use crate::{render::Rendering};\nuse crate::math::Rgb;",
        "fn f<'a>(x: &'a str) {} use std::{sync::Arc, fmt};",
    ] {
        assert_eq!(said_of("film/tile", text), Vec::<String>::new(), "{text}");
    }
    let (_, tests) = source(vec!["film".into()], "mod tile; #[cfg(test)] mod tests; fn f() {}");
    assert_eq!(tests, [vec!["film".to_string(), "tests".to_string()]]);
}

#[test]
fn techniques_that_import_each_other_are_found() {
    for text in ["use crate::technique::octree::Octree;", "use super::super::octree::Octree;"] {
        assert_eq!(said_of("technique/path/cpu", text).len(), 1, "{text}");
    }
    assert_eq!(said_of("technique/path", "use super::octree;").len(), 1);
    assert!(said_of("technique/path/cpu", "use super::super::{Card, Step}; use super::View;").is_empty());
    assert!(said_of("technique", "use path::PathTracer; use crate::technique::path;").is_empty());
}

#[test]
fn wgpu_is_named_where_the_graphics_card_is_used_only() {
    let text = "fn f(device: &wgpu::Device) {}";
    for module in ["gpu", "gpu/session", "technique/path/gpu"] {
        assert_eq!(said_of(module, text), Vec::<String>::new(), "{module}");
    }
    for module in ["technique/path/cpu", "render", "accel/upload"] {
        assert_eq!(said_of(module, text).len(), 1, "{module}");
    }
}

#[test]
fn network_async_and_files_in_the_engine_are_found() {
    for text in [
        "use std::fs;",
        "use std::{fs::File, sync::Arc};",
        "let listener = std::net::TcpListener::bind(a);",
        "use tokio::sync::mpsc;",
        "use axum::Router;",
    ] {
        assert_eq!(said_of("render", text).len(), 1, "{text}");
    }
    assert!(said_of("render", "use std::{fmt, sync::Arc}; // std::fs\n#[cfg(test)] use std::fs;").is_empty());
}
