//! The command line is one contract: this table and `--help` name the same verbs and the same options.

use std::collections::BTreeSet;

use super::sightline;

/// Options of every verb.
const COMMON: [&str; 4] = ["--help", "--json", "--quiet", "--threads"];

/// Each verb with its arguments and its own options.
const VERBS: [(&str, &str, &str); 18] = [
    ("ingest", "<INPUT>...", "-o --unit --void --nodata --crs --memory --png --resample --check --force"),
    ("info", "<DB>", "--thumbnail --statistics --force"),
    ("verify", "<DB>", ""),
    (
        "los",
        "<TARGET>",
        "--from --to --batch -o --coords --altitude --precision --strict --derive --earth --earth-radius --refraction \
         --force",
    ),
    ("profile", "<DB>", "-o --from --to --coords --altitude --earth --earth-radius --refraction --force"),
    (
        "viewshed",
        "<DB>",
        "-o --from --radius --target-height --coords --altitude --strict --earth --earth-radius --refraction \
         --force",
    ),
    ("height", "<DB>", "--at --batch -o --coords --force"),
    ("matrix", "<DB>", "--points -o --coords --altitude --strict --earth --earth-radius --refraction --force"),
    (
        "mesh",
        "<DB>",
        "-o --triangles --pixels --error --eye --look --fov --viewport --lines --fidelity --coords --altitude --force",
    ),
    ("fly", "<DB>", "--flight --frames --triangles --pixels --algorithm --plot -o --seed --force"),
    ("serve", "[DB]", "--listen --config --state --record --record-limit --page-cache --read-ahead --print-config"),
    ("status", "<ADDR>", ""),
    ("replay", "<F>", "--db"),
    ("load", "<ADDR>", "--views --triangles --rate --seconds --los --sight-lines --seed"),
    (
        "view",
        "<ADDR>",
        "-o --triangles --pixels --frame-time --orthographic --region --morph --flight --frames --record --exercise \
         --every --fov --viewport --seed --force",
    ),
    (
        "consistency",
        "<TARGET>...",
        "--servers --clients --sight-lines --frames --seed --budgets --fidelity --changes --map --pictures -o --force",
    ),
    ("evaluate", "", "-o --quick --dem --force"),
    ("demo", "", "--exit --listen -o"),
];

fn help(args: &[&str]) -> String {
    let output = sightline(args);
    assert!(output.status.success(), "{args:?}");
    String::from_utf8(output.stdout).expect("help is UTF-8")
}

/// The options that a help text lists, each by its long name if it has one.
fn options(help: &str) -> BTreeSet<String> {
    let name = |line: &str| {
        let mut words = line.split_whitespace().filter(|word| word.starts_with('-') && word.len() > 1);
        let first = words.next().filter(|first| line.trim_start().starts_with(first))?;
        let name = if first.ends_with(',') { words.next()? } else { first };
        Some(name.to_owned())
    };
    help.lines().filter_map(name).collect()
}

#[test]
fn help_names_the_verbs_of_the_contract() {
    let text = help(&["--help"]);
    let listed: BTreeSet<_> = text
        .lines()
        .skip_while(|line| !line.starts_with("Commands:"))
        .skip(1)
        .take_while(|line| !line.is_empty())
        // Deeper lines go on with the description of the verb before.
        .filter_map(|line| line.strip_prefix("  ").filter(|line| !line.starts_with(' ')))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|verb| *verb != "help")
        .collect();
    assert_eq!(listed, VERBS.iter().map(|(verb, ..)| *verb).collect());
}

#[test]
fn help_of_each_verb_names_its_options_and_no_others() {
    for (verb, arguments, own) in VERBS {
        let text = help(&[verb, "--help"]);
        let expected: BTreeSet<_> = own.split_whitespace().chain(COMMON).map(str::to_owned).collect();
        assert_eq!(options(&text), expected, "{verb}");
        let usage = text.lines().find(|line| line.starts_with("Usage:")).expect("help shows the usage");
        assert!(usage.contains(&format!("sightline {verb}")) && usage.contains(arguments), "{usage}");
    }
}

#[test]
fn what_makes_no_sense_is_refused_with_status_2() {
    for args in [&["fly-to-the-moon"][..], &["los"], &["ingest", "-o"], &["mesh", "--triangles", "many"]] {
        let output = sightline(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(output.stdout.is_empty() && !output.stderr.is_empty(), "{args:?}");
    }
}
