//! Properties of the parser: nothing written makes it panic, whatever is wrong is said in whole lines, and what it
//! accepts resolves.
#![allow(clippy::panic, clippy::unwrap_used)] // helpers of tests are tests

use evpr_core::config::{Overrides, parse, test_catalog};
use evpr_core::member::MAX_MEMBERS;
use evpr_core::plan::Sensor;
use evpr_core::time::format_duration;
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Parses and checks everything that holds for any text.
fn check(text: &str) -> Result<(), TestCaseError> {
    match parse(text, "x.toml", &test_catalog()) {
        Err(errors) => {
            prop_assert!(!errors.errors.is_empty());
            prop_assert_eq!(errors.to_string().split('\n').count(), errors.errors.len());
            let lines = text.split('\n').count();
            for e in &errors.errors {
                prop_assert!((1..=lines).contains(&e.line), "line {} of {lines}: {e}", e.line);
                prop_assert!(e.column >= 1 && !e.message.is_empty());
                prop_assert!(!e.to_string().contains(char::is_control), "{e:?}");
                prop_assert!(!e.message.contains("fault of evpr"), "{e}");
            }
            prop_assert!(errors.errors.windows(2).all(|w| w[0].line <= w[1].line));
        }
        Ok(config) => {
            let sensor = config.sensor().unwrap_or(Sensor { height: 4, width: 6 });
            let overrides = Overrides {
                input: Some(PathBuf::from("events.h5")),
                ..Overrides::default()
            };
            let plan = config.resolve(sensor, &overrides);
            prop_assert!(plan.is_ok_and(|p| (1..=MAX_MEMBERS).contains(&p.members.len())));
        }
    }
    Ok(())
}

fn example() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/ensemble.toml");
    let text = std::fs::read_to_string(path).unwrap();
    // Mutations should hit keys and values, not comments.
    let kept = text
        .lines()
        .filter(|line| !line.starts_with('#') && !line.is_empty());
    kept.collect::<Vec<_>>().join("\n")
}

/// Bits of TOML in any order: far more often nearly right than arbitrary text is.
fn soup() -> impl Strategy<Value = String> {
    let bits = [
        "[slicing]\n",
        "[[reconstruction]]\n",
        "[[extractor]]\n",
        "[fuse]\n",
        "[ensemble]\n",
        "tick",
        "windows",
        "id",
        "params",
        "sequence",
        "weights",
        "members",
        "kind",
        " = ",
        ".",
        "\"1s\"",
        "\"event_count\"",
        "\"patch_norm\"",
        "1",
        "-0.5",
        "nan",
        "[",
        "]",
        "{",
        "}",
        ", ",
        "\n",
        "\"",
        "'",
        "\"\"\"",
        "true",
        "2026-01-01",
        "#",
        "\\",
        "µ",
        "\u{0}",
        "\r",
    ];
    proptest::collection::vec(proptest::sample::select(bits.to_vec()), 0..60).prop_map(|bits| bits.concat())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn arbitrary_text_never_panics(text in any::<String>()) {
        check(&text)?;
    }

    #[test]
    fn soup_never_panics(text in soup()) {
        check(&text)?;
    }

    #[test]
    fn a_mutated_configuration_never_panics(
        cuts in proptest::collection::vec((any::<prop::sample::Index>(), 0usize..12, soup()), 1..4),
    ) {
        let mut chars: Vec<char> = example().chars().collect();
        for (at, remove, insert) in cuts {
            let at = at.index(chars.len());
            let end = (at + remove).min(chars.len());
            let short: Vec<char> = insert.chars().take(remove).collect();
            chars.splice(at..end, short);
        }
        check(&chars.into_iter().collect::<String>())?;
    }

    #[test]
    fn lines_in_another_order_never_panic(
        lines in Just(example().lines().map(str::to_owned).collect::<Vec<_>>()).prop_shuffle(),
    ) {
        check(&lines.join("\n"))?;
    }

    #[test]
    fn every_value_may_be_replaced_by_any_other(at in any::<prop::sample::Index>(), value in soup()) {
        let text = example();
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let with_value: Vec<usize> = (0..lines.len()).filter(|i| lines[*i].contains('=')).collect();
        let line = with_value[at.index(with_value.len())];
        let key = lines[line].split('=').next().unwrap_or_default().to_owned();
        lines[line] = format!("{key}= {value}");
        check(&lines.join("\n"))?;
    }

    #[test]
    fn members_are_all_combinations_in_order(
        reconstructions in proptest::collection::btree_set("[a-z0-9_-]{1,8}", 1..5),
        extractors in proptest::collection::btree_set("[a-z0-9_-]{1,8}", 1..4),
        windows in proptest::collection::btree_set(1u64..1000, 1..6),
    ) {
        let list: Vec<String> = windows.iter().rev().map(|ms| format!("\"{ms}ms\"")).collect();
        let mut text = format!("slicing.windows = [{}]\n", list.join(","));
        for id in &reconstructions {
            text += &format!("[[reconstruction]]\nid = \"{id}\"\nkind = \"event_count\"\n");
        }
        for id in &extractors {
            text += &format!("[[extractor]]\nid = \"{id}\"\nkind = \"raw_pixels\"\n");
        }
        let config = parse(&text, "x.toml", &test_catalog()).map_err(|e| TestCaseError::fail(e.to_string()))?;
        let mut expected = Vec::new();
        for r in &reconstructions {
            for w in &windows {
                for e in &extractors {
                    expected.push(format!("{r}@{}/{e}", format_duration(w * 1_000_000)));
                }
            }
        }
        let names: Vec<String> = config.members().iter().map(|m| m.name.clone()).collect();
        prop_assert_eq!(&names, &expected);
        prop_assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len());
    }
}
