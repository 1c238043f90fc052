//! What is shown: the configuration of the demonstration, and the plans made of it.

use crate::catalog::CATALOG;
use crate::failure::Failure;
use evpr_core::Plan;
use evpr_core::config::{self, Overrides};
use evpr_core::plan::{Pace, StreetPass};
use std::path::Path;

/// The configuration, as it stands in the repository.
const CONFIG: &str = include_str!("../../../../config/demo.toml");
/// What it is called in messages, and in the report.
pub(crate) const CONFIG_NAME: &str = "demo.toml";
/// Shared memory that a plan of the demonstration may come to need: what containers have by default.
pub(crate) const SHARED_MEMORY_LIMIT: u64 = 64 << 20;
/// What `--quick` changes: key and value.
const QUICK: [(&str, &str); 5] = [
    ("height", "60"),
    ("width", "80"),
    ("length_m", "60.0"),
    ("speed_m_s", "5.0"),
    ("step", "\"10ms\""),
];

/// What is shown.
#[derive(Debug, Clone)]
pub(crate) struct Setup {
    /// What the street is drawn from.
    pub(crate) seed: u32,
    /// Whether it is the small variant for tests.
    pub(crate) quick: bool,
}

impl Setup {
    /// Ticks of the run in real time, in which latency is measured.
    pub(crate) fn paced_ticks(&self) -> u32 {
        if self.quick { 4 } else { 12 }
    }

    /// The configuration as it is run.
    pub(crate) fn config(&self) -> String {
        let seed = self.seed.to_string();
        let text = with_value(CONFIG, "seed", &seed);
        let quick = QUICK.iter().filter(|_| self.quick);
        quick.fold(text, |text, (key, value)| with_value(&text, key, value))
    }

    /// The plan of a drive; `pace` and the length of the drive are those of the configuration unless given.
    fn resolve(&self, text: &str, pass: StreetPass, overrides: Overrides) -> Result<Plan, Failure> {
        let config = config::parse(text, CONFIG_NAME, &CATALOG).map_err(Failure::new)?;
        let sensor = config
            .sensor()
            .ok_or_else(|| Failure::new(format!("{CONFIG_NAME}: the sensor's size is missing")))?;
        let overrides = Overrides {
            input: Some(pass.name().into()),
            ..overrides
        };
        let plan = config.resolve(sensor, &overrides).map_err(Failure::new)?;
        let needed = evpr_runtime::room(&plan)?.needed;
        if needed > SHARED_MEMORY_LIMIT {
            return Err(Failure::new(format!(
                "{CONFIG_NAME}: the plan may need {needed} bytes of shared memory, more than the {SHARED_MEMORY_LIMIT} \
                 that the demonstration allows itself"
            )));
        }
        Ok(plan)
    }

    /// The drive that is mapped: its rows go to `record`.
    pub(crate) fn mapping(&self, record: &Path) -> Result<Plan, Failure> {
        let overrides = Overrides {
            record: Some(record.to_owned()),
            ..Overrides::default()
        };
        self.resolve(&self.config(), StreetPass::Day, overrides)
    }

    /// A drive that is matched against `map`, and whose rows go to `record`.
    pub(crate) fn matching(&self, pass: StreetPass, map: &Path, record: &Path) -> Result<Plan, Failure> {
        let overrides = Overrides {
            map: Some(map.to_owned()),
            record: Some(record.to_owned()),
            ..Overrides::default()
        };
        self.resolve(&self.config(), pass, overrides)
    }

    /// The first few ticks of the first drive in real time, matched against `map`.
    pub(crate) fn paced(&self, map: &Path) -> Result<Plan, Failure> {
        let full = self.mapping(map)?;
        let (Some(street), tick_s) = (&full.source.street, full.slicing.tick as f64 / 1e9) else {
            return Err(Failure::new(format!("{CONFIG_NAME}: the source is no street")));
        };
        // Half a tick more: only ticks that lie wholly inside a recording are answered.
        let length_m = (f64::from(self.paced_ticks()) + 0.5) * tick_s * street.speed_m_s;
        let text = with_value(&self.config(), "length_m", &format!("{length_m:.1}"));
        let overrides = Overrides {
            map: Some(map.to_owned()),
            pace: Some(Pace::Factor(1.0)),
            ..Overrides::default()
        };
        self.resolve(&text, StreetPass::Day, overrides)
    }
}

/// The configuration with another value for this key, wherever a line sets it.
fn with_value(text: &str, key: &str, value: &str) -> String {
    let line = |line: &str| match line.split_once('=') {
        Some((name, _)) if name.trim() == key => format!("{key} = {value}\n"),
        _ => format!("{line}\n"),
    };
    text.lines().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setup(quick: bool) -> Setup {
        Setup { seed: 7, quick }
    }

    #[test]
    fn plans_fit_what_containers_have_and_are_made_of_one_configuration() {
        let (map, record) = (Path::new("map"), Path::new("record"));
        for quick in [false, true] {
            let setup = setup(quick);
            let mapping = setup.mapping(record).unwrap();
            let night = setup.matching(StreetPass::Night, map, record).unwrap();
            let paced = setup.paced(map).unwrap();
            let street = |plan: &Plan| plan.source.street.clone().unwrap();
            assert_eq!(street(&mapping).seed, 7);
            assert_eq!(
                (street(&mapping).pass, street(&night).pass),
                (StreetPass::Day, StreetPass::Night)
            );
            assert!(street(&paced).length_m < street(&mapping).length_m);
            assert_eq!(paced.source.pace, Pace::Factor(1.0));
            // Rows of all of them can be compared.
            for member in 0..mapping.members.len() {
                assert_eq!(mapping.fingerprint(member), night.fingerprint(member));
                assert_eq!(mapping.fingerprint(member), paced.fingerprint(member));
            }
        }
    }

    #[test]
    fn the_whole_demonstration_has_at_least_80_ticks_and_36_members() {
        let plan = setup(false).mapping(Path::new("record")).unwrap();
        let street = plan.source.street.unwrap();
        assert!(street.length_m / street.speed_m_s >= 80.0);
        assert_eq!(plan.members.len(), 36);
    }

    #[test]
    fn every_value_that_is_replaced_is_there() {
        let keys = QUICK.iter().map(|(key, _)| *key).chain(["seed", "length_m"]);
        for key in keys {
            let changed = with_value(CONFIG, key, "\"another value\"");
            assert_eq!(changed.matches("another value").count(), 1, "{key}");
        }
    }
}
