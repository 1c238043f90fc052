//! What this executable knows, and how a configuration file becomes a plan.

use crate::failure::Failure;
use evpr_core::Plan;
use evpr_core::config::{self, Config, Overrides};
use evpr_core::plan::Catalog;
use std::path::Path;

/// The reconstructions and extractors of this executable.
pub(crate) const CATALOG: Catalog = Catalog {
    reconstructions: &evpr_reconstruct::ALL_KINDS,
    extractors: &evpr_extract::KINDS,
};

/// Reads and checks a configuration.
pub(crate) fn load(path: &Path) -> Result<Config, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|e| Failure::new(format!("cannot read the configuration {}: {e}", path.display())))?;
    config::parse(&text, &path.display().to_string(), &CATALOG).map_err(Failure::new)
}

/// Makes the plan: what the configuration leaves open about the sensor is asked of the recording, and
/// the hot pixels are found.
pub(crate) fn plan(path: &Path, overrides: &Overrides) -> Result<Plan, Failure> {
    let config = load(path)?;
    let sensor = match config.source(overrides) {
        // Without a recording there is nothing to ask; `resolve` then says that it is missing.
        None => config.sensor(),
        Some(source) => evpr_ingest::probe(&source)?.or(config.sensor()),
    };
    let sensor = match sensor {
        Some(sensor) => sensor,
        None if config.source(overrides).is_none() => evpr_core::plan::Sensor { height: 1, width: 1 },
        None => {
            return Err(Failure::new(format!(
                "{}: the recording does not tell the sensor's size; add a section [sensor] with height and width",
                path.display()
            )));
        }
    };
    let mut plan = config.resolve(sensor, overrides).map_err(Failure::new)?;
    evpr_ingest::find_hot_pixels(&mut plan)?;
    Ok(plan)
}
