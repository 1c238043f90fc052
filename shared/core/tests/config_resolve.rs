//! From the checked configuration to the plan: what the command line and the recording add.
#![allow(clippy::panic, clippy::unwrap_used)] // helpers of tests are tests

use evpr_core::config::{Config, Overrides, parse, test_catalog};
use evpr_core::plan::{Delivery, OnBadEvent, Pace, Plan, Sensor, StreetPass};
use std::path::PathBuf;

const STAGES: &str = "[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n";
const SENSOR: Sensor = Sensor {
    height: 260,
    width: 346,
};

fn config(before: &str) -> Config {
    parse(&format!("{before}\n{STAGES}"), "x.toml", &test_catalog()).unwrap_or_else(|e| panic!("{e}"))
}

fn input() -> Overrides {
    Overrides {
        input: Some(PathBuf::from("other.h5")),
        ..Overrides::default()
    }
}

#[test]
fn the_recording_may_come_from_either_side_but_must_come() {
    let from_file = config("[source]\npath = \"events.h5\"");
    let path = |c: &Config, o: &Overrides| c.resolve(SENSOR, o).map(|p| p.source.path);
    assert_eq!(
        path(&from_file, &Overrides::default()).unwrap(),
        PathBuf::from("events.h5")
    );
    assert_eq!(path(&from_file, &input()).unwrap(), PathBuf::from("other.h5"));
    let open = config("\n[source]\npace = 2.0");
    assert_eq!(open.source(&Overrides::default()), None);
    assert_eq!(path(&open, &input()).unwrap(), PathBuf::from("other.h5"));
    let errors = path(&open, &Overrides::default()).unwrap_err();
    assert_eq!(
        errors.to_string(),
        "x.toml:2: source.path: is missing; write the recording's path here, or give it with --input"
    );
}

#[test]
fn the_command_line_takes_precedence() {
    let config =
        config("[source]\npace = \"realtime\"\n[runtime]\ndelivery = \"latest\"\ndeadline = \"50ms\"");
    let plain = config.resolve(SENSOR, &input()).unwrap();
    assert_eq!(
        (plain.source.pace, plain.delivery),
        (Pace::Factor(1.0), Delivery::Latest)
    );
    assert_eq!(
        (plain.name.as_str(), plain.map, plain.record),
        ("evpr", None, None)
    );
    let overrides = Overrides {
        name: Some("second".to_owned()),
        pace: Some(Pace::Unpaced),
        delivery: Some(Delivery::Lossless),
        map: Some(PathBuf::from("map")),
        record: Some(PathBuf::from("out")),
        ..input()
    };
    let plan = config.resolve(SENSOR, &overrides).unwrap();
    assert_eq!(
        (plan.source.pace, plan.delivery),
        (Pace::Unpaced, Delivery::Lossless)
    );
    assert_eq!(plan.name, "second");
    assert_eq!(
        (plan.map, plan.record),
        (Some(PathBuf::from("map")), Some(PathBuf::from("out")))
    );
}

#[test]
fn the_recording_must_have_the_sensor_that_the_configuration_gives() {
    let given = config("[sensor]\nheight = 260\nwidth = 346");
    assert_eq!(given.sensor(), Some(SENSOR));
    assert_eq!(given.resolve(SENSOR, &input()).unwrap().sensor, SENSOR);
    let turned = Sensor {
        height: 346,
        width: 260,
    };
    let message = given.resolve(turned, &input()).unwrap_err().to_string();
    assert!(
        message.starts_with("x.toml:1: sensor: is 260×346 (height × width), but"),
        "{message}"
    );
    assert_eq!(config("").sensor(), None);
    for height in [0, 8193] {
        assert!(config("").resolve(Sensor { height, width: 1 }, &input()).is_err());
    }
}

#[test]
fn all_that_is_wrong_with_the_command_line_is_said_at_once() {
    let overrides = Overrides {
        name: Some("Two Words".to_owned()),
        pace: Some(Pace::Factor(f64::NAN)),
        ..Overrides::default()
    };
    let errors = config("").resolve(SENSOR, &overrides).unwrap_err();
    let keys: Vec<&str> = errors.errors.iter().map(|e| e.key.as_str()).collect();
    assert_eq!(keys, ["--name", "--pace", "source.path"]);
    let text = errors.to_string();
    assert!(
        text.starts_with("command line: --name: \"Two Words\" cannot be a name; write 1 to 20"),
        "{text}"
    );
}

#[test]
fn a_street_needs_no_recording_and_its_pass_may_be_given() {
    let street =
        config("[sensor]\nheight = 260\nwidth = 346\n[source]\nkind = \"street\"\nstreet = { seed = 7 }");
    let plan = street.resolve(SENSOR, &Overrides::default()).unwrap();
    let found = plan.source.street.unwrap();
    assert_eq!(
        (found.pass, found.seed, found.sensor),
        (StreetPass::Day, 7, SENSOR)
    );
    let with_input = |input: &str| {
        let overrides = Overrides {
            input: Some(PathBuf::from(input)),
            ..Overrides::default()
        };
        street.resolve(SENSOR, &overrides)
    };
    for pass in StreetPass::ALL {
        let source = with_input(pass.name()).unwrap().source;
        assert_eq!(
            source.path,
            PathBuf::from(format!("street ({}, seed 7)", pass.name()))
        );
        assert_eq!(source.street.unwrap().pass, pass);
    }
    assert_eq!(
        with_input("nigth").unwrap_err().to_string(),
        "command line: --input: with source.kind = \"street\", \"nigth\" is not known here; did you mean \"night\"? \
         write \"day\", \"day2\" or \"night\""
    );
}

#[test]
fn frames_have_one_window_and_may_be_given_a_size() {
    let stages = "[[reconstruction]]\nid = \"frames\"\n[[extractor]]\nid = \"patch_norm\"\n";
    let text = |more: &str| {
        format!(
            "[sensor]\nheight = 260\nwidth = 346\n[source]\nkind = \"frames\"\npath = \"folder\"\n{more}\n{stages}"
        )
    };
    let plan = |text: &str| {
        let config = parse(text, "x.toml", &test_catalog()).unwrap();
        config.resolve(SENSOR, &Overrides::default()).unwrap()
    };
    let exact = plan(&text(""));
    assert_eq!(exact.source.frames.as_ref().unwrap().size, None);
    assert_eq!(exact.members[0].name, "frames@1s/patch_norm");
    assert_eq!((exact.reconstructions[0].channels, exact.chunk_events()), (3, 1));
    let resized = plan(&text("frames = { on_other_size = \"resize\" }"));
    assert_eq!(resized.source.frames.unwrap().size, Some(SENSOR));
}

#[test]
fn errors_have_lines_and_columns_in_characters() {
    let text =
        format!("[run]\nname = 'µ' # µ\n{STAGES}params = {{ µ = 1, side = 0 }}\n").replace("{ µ", "{ \"µ\"");
    let errors = parse(&text, "x.toml", &test_catalog()).unwrap_err().errors;
    let places: Vec<(usize, usize, &str)> = errors
        .iter()
        .map(|e| (e.line, e.column, e.key.as_str()))
        .collect();
    assert_eq!(
        places,
        [
            (2, 8, "run.name"),
            (7, 12, "extractor[0].params.\"µ\""),
            (7, 28, "extractor[0].params.side")
        ]
    );
}

fn live(kind: &str, keys: &str, overrides: &Overrides) -> Result<Plan, String> {
    let text = format!(
        "[source]\nkind = \"{kind}\"\n{keys}[[reconstruction]]\nid = \"event_count\"\n[[extractor]]\nid = \"patch_norm\"\n"
    );
    let config = parse(&text, "x.toml", &test_catalog()).map_err(|e| e.to_string())?;
    let sensor = Sensor {
        height: 260,
        width: 346,
    };
    config.resolve(sensor, overrides).map_err(|e| e.to_string())
}

#[test]
fn a_camera_drops_what_cannot_be_right_and_standard_input_does_when_it_is_live() {
    let overrides = |delivery| Overrides {
        delivery: Some(delivery),
        ..Overrides::default()
    };
    let (lossless, latest) = (overrides(Delivery::Lossless), overrides(Delivery::Latest));
    for (kind, keys, overrides, is_live) in [
        ("stdin", "", &lossless, false),
        ("stdin", "", &latest, true),
        ("tcp", "address = \"a:1\"\n", &lossless, true),
        ("usb", "", &latest, true),
    ] {
        let plan = live(kind, keys, overrides).unwrap();
        let policy = if is_live {
            OnBadEvent::Drop
        } else {
            OnBadEvent::Error
        };
        assert_eq!(
            (
                plan.is_live(),
                plan.source.on_backward_time,
                plan.source.on_outside_sensor
            ),
            (is_live, policy, policy),
            "{kind}"
        );
        let plan = live(kind, &format!("{keys}on_backward_time = \"clamp\"\n"), overrides).unwrap();
        assert_eq!(plan.source.on_backward_time, OnBadEvent::Clamp);
    }
}

#[test]
fn the_command_line_gives_an_address_and_nothing_that_a_live_source_has_no_use_for() {
    let input = |text: &str| Overrides {
        input: Some(text.into()),
        ..Overrides::default()
    };
    let plan = live("tcp", "address = \"a:1\"\n", &input("b:2")).unwrap();
    assert_eq!(plan.source.live.unwrap().address.as_deref(), Some("b:2"));
    assert_eq!(
        live("tcp", "", &Overrides::default()).unwrap_err(),
        "x.toml:1: source.address: is missing; write the camera's address here, such as \"192.168.0.7:7777\", or give it \
         with --input"
    );
    let overrides = Overrides {
        pace: Some(Pace::Factor(1.0)),
        ..input("x.h5")
    };
    assert_eq!(
        live("tcp", "", &overrides).unwrap_err(),
        "command line: --input: \"x.h5\" is no address; write host and port, such as \"192.168.0.7:7777\"\n\
         command line: --pace: has no effect with source.kind = \"tcp\"; leave it out"
    );
    assert_eq!(
        live("usb", "", &input("x.h5")).unwrap_err(),
        "command line: --input: has no effect with source.kind = \"usb\"; leave it out"
    );
}

#[test]
fn positions_go_with_their_recording() {
    let both = config("[source]\npath = \"a.h5\"\n[positions]\npath = \"a.nmea\"");
    let path = |c: &Config, o: &Overrides| {
        let plan = c.resolve(SENSOR, o);
        plan.map(|p| p.source.positions.map(|p| p.path))
            .map_err(|e| e.to_string())
    };
    assert_eq!(
        path(&both, &Overrides::default()),
        Ok(Some(PathBuf::from("a.nmea")))
    );
    let same = Overrides {
        input: Some(PathBuf::from("a.h5")),
        ..Overrides::default()
    };
    assert_eq!(path(&both, &same), Ok(Some(PathBuf::from("a.nmea"))));
    let error = path(&both, &input()).unwrap_err();
    assert!(
        error.starts_with("command line: --input: a.nmea (positions.path) belongs to"),
        "{error}"
    );
    let given = Overrides {
        positions: Some(PathBuf::from("other.csv")),
        ..input()
    };
    assert_eq!(path(&both, &given), Ok(Some(PathBuf::from("other.csv"))));
    assert_eq!(path(&config(""), &given), Ok(Some(PathBuf::from("other.csv"))));
    assert_eq!(path(&config(""), &input()), Ok(None));
    let crop = config("[positions]\ncrop = \"track\"");
    assert_eq!(
        path(&crop, &input()).unwrap_err(),
        "x.toml:2: positions.crop: has no effect without positions; write positions.path, or give them with --positions"
    );
    assert!(path(&crop, &given).is_ok());
    let street = config("[source]\nkind = \"street\"");
    let overrides = Overrides {
        positions: Some(PathBuf::from("other.csv")),
        ..Overrides::default()
    };
    assert!(
        path(&street, &overrides)
            .unwrap_err()
            .contains("--positions: the simulated street")
    );
}
