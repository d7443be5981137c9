//! The help texts, as snapshots: they are the first thing a newcomer reads, so a change of them is
//! deliberate. After one, look at `cargo test --test help` and accept with `INSTA_UPDATE=always`.

#![allow(clippy::unwrap_used)] // a helper of tests, like the tests themselves

fn help(command: &[&str]) -> String {
    let mut run = assert_cmd::Command::new(env!("CARGO_BIN_EXE_interfacet"));
    // Help is folded to the terminal's width.
    let output = run.args(command).arg("--help").env("COLUMNS", "100").output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
    text.lines().map(|line| line.trim_end().to_owned() + "\n").collect()
}

#[test]
fn help_of_interfacet() {
    insta::assert_snapshot!(help(&[]));
}

#[test]
fn help_of_extract() {
    insta::assert_snapshot!(help(&["extract"]));
}

#[test]
fn every_command_shows_examples_that_it_accepts_by_name() {
    for command in ["extract", "info", "check", "phantom", "compare", "residual", "render"] {
        let text = help(&[command]);
        let examples = text.split("Examples:\n").nth(1).unwrap_or_else(|| panic!("{command}: {text}"));
        let of_it = examples.lines().filter(|line| line.starts_with(&format!("  interfacet {command} ")));
        for example in of_it.clone() {
            for option in example.split_whitespace().filter(|word| word.starts_with("--")) {
                assert!(
                    text.contains(&format!("{option} ")) || text.contains(&format!("{option}\n")),
                    "{option}"
                );
            }
        }
        assert!(of_it.count() >= 2, "{command}: {examples}");
    }
}
