//! Members switched off and on while the graph runs.

use super::support::{Bench, Running, TICKS, assert_ticks, run_args};
use evpr_core::config::{self, Overrides};
use evpr_core::message::FuseSettings;
use evpr_core::plan::{Catalog, Models, Plan, Sensor};
use evpr_core::{MemberSet, Reason};
use evpr_fuse::{Map, offline};
use serde_json::Value;
use std::path::Path;

pub(crate) fn plan(bench: &Bench, config: &Path, input: &Path, map: &Path) -> Plan {
    let catalog = Catalog {
        reconstructions: &evpr_reconstruct::KINDS,
        extractors: &evpr_extract::KINDS,
        models: Models::NONE,
        cores: 2,
    };
    let text = std::fs::read_to_string(config).unwrap();
    let config = config::parse(&text, "ensemble.toml", &catalog).unwrap();
    let overrides = Overrides {
        input: Some(input.to_owned()),
        map: Some(map.to_owned()),
        ..Overrides::default()
    };
    let _ = bench;
    config
        .resolve(
            Sensor {
                height: 48,
                width: 64,
            },
            &overrides,
        )
        .unwrap()
}

/// Asks the running instance and gives the tick from which the change holds.
pub(crate) fn switch(bench: &Bench, verb: &str, member: &str) -> u64 {
    let said = bench.run(&["member", verb, "--json", member]);
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let reply: Value = serde_json::from_str(&said.stdout).unwrap();
    reply["from_tick"]
        .as_u64()
        .unwrap_or_else(|| panic!("no tick in {reply}"))
}

/// Checks that the answers are those of an offline evaluation of recorded rows with exactly these members and settings at
/// each tick.
pub(crate) fn assert_as_offline(
    plan: &Plan,
    recorded: &Path,
    answers: &[Value],
    enabled: &dyn Fn(u64) -> MemberSet,
    settings: impl Fn(u64) -> FuseSettings,
) {
    let expected = offline::answers_with(
        plan,
        Map::open(plan).unwrap(),
        &offline::Query::open(plan, recorded).unwrap(),
        enabled,
        settings,
    )
    .unwrap();
    assert_eq!(expected.len(), answers.len());
    for ((header, _), answer) in expected.iter().zip(answers) {
        let reference = u64::try_from(header.reference).ok();
        assert_eq!(answer["reference"].as_u64(), reference, "{answer}");
        if reference.is_some() {
            let (got, wanted) = (answer["score"].as_f64().unwrap(), header.score);
            assert!(
                (got - wanted).abs() <= 1e-9,
                "tick {}: {got} against {wanted}",
                header.tick
            );
        } else {
            assert_eq!(
                answer["reason"].as_str(),
                Reason::from_code(header.reason).map(Reason::text)
            );
        }
        let used = enabled(header.tick)
            .iter()
            .map(|m| plan.members[m].name.as_str())
            .collect::<Vec<_>>();
        assert_eq!(
            answer["members"]
                .as_array()
                .unwrap()
                .iter()
                .map(|m| m.as_str().unwrap())
                .collect::<Vec<_>>(),
            used
        );
    }
}

#[test]
fn every_member_goes_off_and_on_and_the_answers_are_those_of_exactly_these_holes() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let recorded = bench.path("recorded");
    assert_eq!(bench.record(&config, &query, &recorded).code(), 0);

    let plan = plan(&bench, &config, &query, &map);
    let args = run_args(&config, &query, &map, &["--pace", "4"]);
    let mut running = Running::start(&bench, &args);
    let mut off: Vec<(usize, u64, u64)> = Vec::new();
    for (index, member) in plan.members.iter().enumerate() {
        assert!(running.read_to(15 * (index as u64 + 1)));
        let from = switch(&bench, "disable", &member.name);
        assert!(running.read_to(from + 6));
        off.push((index, from, switch(&bench, "enable", &member.name)));
    }
    // And all at once, which leaves nothing to answer with.
    let none_from = switch(&bench, "disable", "all");
    assert!(running.read_to(none_from + 4));
    let none_until = switch(&bench, "enable", "all");
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    assert!(
        answers
            .iter()
            .all(|a| a["missing"].as_object().unwrap().is_empty()),
        "nothing enabled was missing"
    );

    let enabled = |tick: u64| -> MemberSet {
        let is_off = |m: usize| {
            off.iter()
                .any(|(index, from, until)| *index == m && (*from..*until).contains(&tick))
        };
        let none = (none_from..none_until).contains(&tick);
        (0..plan.members.len()).filter(|m| !none && !is_off(*m)).collect()
    };
    assert_as_offline(&plan, &recorded, &answers, &enabled, |_| FuseSettings::default());
    let in_the_dark = &answers[none_from as usize];
    assert_eq!(in_the_dark["reason"], "all members are disabled");
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}

#[test]
fn unknown_members_and_illegal_weights_are_refused_and_weights_take_effect() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let args = run_args(&config, &query, &map, &["--pace", "5"]);
    let mut running = Running::start(&bench, &args);
    assert!(running.read_to(5));
    for (args, words, code) in [
        (
            ["member", "disable", "event_cont@50ms/patch_norm"].as_slice(),
            "there is no member",
            1,
        ),
        (&["member", "weight", "-1", "all"], "not a weight", 2),
        (&["member", "weight", "NaN", "all"], "not a weight", 2),
    ] {
        let said = bench.run(args);
        assert_eq!(said.code(), code, "{args:?}");
        assert_eq!(said.errors().len(), 1, "{}", said.stderr);
        assert!(said.stderr.contains(words), "{}", said.stderr);
    }
    let list = bench.run(&["member", "list"]);
    assert_eq!(list.stdout.lines().count(), 9, "{}", list.stdout);
    let said = bench.run(&["member", "weight", "--json", "2.5", "event_count@50ms/patch_norm"]);
    let reply: Value = serde_json::from_str(&said.stdout).unwrap();
    assert_eq!(reply["members"][0]["weight"], 2.5, "{reply}");
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
}
