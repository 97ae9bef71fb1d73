//! The house plan, enforced: data flows down the list of modules, imports point up it, and side effects stay where
//! they belong. See "Map" and "Invariants" in `ARCHITECTURE.md`.
//!
//! The check reads source text, with comments and string literals removed; it knows `crate::` paths and `use` groups.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

/// The modules of the root crate in the order of data flow. A module may import those before it.
const MODULES: [&str; 14] = [
    "terrain", "wedgie", "view", "dem", "database", "los", "roam", "lod", "exercise", "session", "evaluate", "store",
    "service", "cli",
];

/// Pairs (importer, imported) that the order allows and the plan forbids.
const FORBIDDEN: [(&str, &str); 7] = [
    ("los", "database"),
    ("los", "dem"),
    ("roam", "database"),
    ("roam", "dem"),
    ("lod", "database"),
    ("lod", "dem"),
    // The other systems are compared with ours, so none of them may be a setting of it.
    ("lod", "roam"),
];

/// A side effect or a source of differing bits, by the text that betrays it, and the modules that may have it.
struct Confined {
    what: &'static str,
    texts: &'static [&'static str],
    allowed: &'static [&'static str],
}

const CONFINED: [Confined; 4] = [
    Confined {
        what: "files",
        texts: &["std::fs", "fs::", "File::open", "File::create"],
        allowed: &["dem", "database", "store", "cli"],
    },
    Confined {
        what: "sockets and tokio",
        texts: &["tokio::", "std::net", "TcpListener"],
        allowed: &["service", "cli"],
    },
    Confined { what: "clocks", texts: &["Instant::now", "SystemTime"], allowed: &["service", "cli"] },
    Confined {
        what: "operations whose bits differ between machines",
        texts: &[
            ".mul_add(",
            ".sin(",
            ".cos(",
            ".tan(",
            ".sin_cos(",
            ".asin(",
            ".acos(",
            ".atan(",
            ".atan2(",
            ".exp(",
            ".ln(",
            ".powf(",
            ".log2(",
            ".log10(",
            ".hypot(",
            ".cbrt(",
        ],
        allowed: &["cli"],
    },
];

/// Files that may use transcendental functions although their module may not, each with its reason.
const TRANSCENDENTAL: [&str; 2] = [
    // The scene scale is computed once, at ingest, and stored.
    "src/terrain/georeference.rs",
    // Flights are inputs: a client computes its poses and sends their bits.
    "src/evaluate/flight.rs",
];

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// The text without comments, string literals and the unit tests at its end.
fn code(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    while let Some(at) = rest.find(['/', '"']) {
        out.push_str(&rest[..at]);
        rest = &rest[at..];
        if rest.starts_with("//") {
            rest = rest.find('\n').map_or("", |end| &rest[end..]);
        } else if rest.starts_with('"') && !out.ends_with('\'') {
            let mut escaped = false;
            let end = rest[1..].find(|c: char| {
                let ends = c == '"' && !escaped;
                escaped = c == '\\' && !escaped;
                ends
            });
            rest = end.map_or("", |end| &rest[end + 2..]);
        } else {
            out.push_str(&rest[..1]);
            rest = &rest[1..];
        }
    }
    out.push_str(rest);
    out
}

/// The first segments of all paths that start with `crate::`, those in `use` groups included.
fn imported(code: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        let Some(group) = rest.strip_prefix('{') else {
            found.insert(first_segment(rest));
            continue;
        };
        let mut depth = 0;
        let mut start = true;
        for (n, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => start = true,
                c if start && depth == 0 && !c.is_whitespace() => {
                    found.insert(first_segment(&group[n..]));
                    start = false;
                }
                _ => {}
            }
        }
    }
    found
}

fn first_segment(path: &str) -> String {
    path.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

/// The module of a file below `src/`, `None` for `lib.rs` and `main.rs`.
fn module(path: &Path) -> Option<&str> {
    let relative = path.strip_prefix(root().join("src")).ok()?;
    let first = relative.components().next()?.as_os_str();
    MODULES.into_iter().find(|m| first == *m)
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn imports_point_up_the_list() {
    let mut wrong = Vec::new();
    for path in sources(&root().join("src")) {
        let Some(importer) = module(&path) else { continue };
        let place = MODULES.iter().position(|m| *m == importer).unwrap();
        for name in imported(&code(&fs::read_to_string(&path).unwrap())) {
            let Some(other) = MODULES.iter().position(|m| *m == name) else { continue };
            if other > place || FORBIDDEN.contains(&(importer, MODULES[other])) {
                wrong.push(format!("{}: {importer} imports {name}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_module_is_on_the_list() {
    let lib = code(&fs::read_to_string(root().join("src/lib.rs")).unwrap());
    let declared: Vec<_> = lib.match_indices("pub mod ").map(|(at, m)| first_segment(&lib[at + m.len()..])).collect();
    assert!(!declared.is_empty());
    for name in &declared {
        assert!(MODULES.contains(&name.as_str()), "src/lib.rs declares {name}, which has no place in the data flow");
    }
}

#[test]
fn side_effects_stay_where_they_belong() {
    let mut wrong = Vec::new();
    for path in sources(&root().join("src")) {
        let Some(module) = module(&path) else { continue };
        let excepted = TRANSCENDENTAL.iter().any(|f| path == root().join(f));
        let text = code(&fs::read_to_string(&path).unwrap());
        for confined in &CONFINED {
            if confined.allowed.contains(&module) || (excepted && confined.what.starts_with("operations")) {
                continue;
            }
            for found in confined.texts.iter().filter(|t| text.contains(**t)) {
                wrong.push(format!("{}: {} ({found}) in {module}", path.display(), confined.what));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_crates_depend_one_way() {
    let manifest = |path: &str| fs::read_to_string(root().join(path)).unwrap();
    let dependencies = |text: String| {
        text.lines()
            .filter(|l| l.starts_with("sightline"))
            .map(|l| l.split(['.', ' ', '=']).next().unwrap_or_default().to_owned())
            .collect::<BTreeSet<_>>()
    };
    assert!(dependencies(manifest("proto/Cargo.toml")).is_empty());
    assert_eq!(dependencies(manifest("clients/rust/Cargo.toml")), BTreeSet::from(["sightline-proto".to_owned()]));
    for path in sources(&root().join("proto/src")).into_iter().chain(sources(&root().join("clients/rust/src"))) {
        let text = code(&fs::read_to_string(&path).unwrap());
        assert!(!text.contains("sightline::"), "{} reaches into the server", path.display());
        assert!(!text.contains(".mul_add("), "{} uses a fused multiply-add", path.display());
    }
}

#[test]
fn the_check_sees_what_it_should() {
    let text =
        "use crate::{los::walk, roam::{View, Mesh}};\n// crate::cli\nlet s = \"crate::store\"; crate::dem::open();";
    let names: Vec<_> = imported(&code(text)).into_iter().collect();
    assert_eq!(names, ["dem", "los", "roam"]);
    assert!(code("a.mul_add(b, c) // x").contains(".mul_add("));
    assert!(!code("let a = \"\\\".mul_add(\";").contains(".mul_add("));
}
