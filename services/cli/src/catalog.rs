//! What this executable knows, and how a configuration file becomes a plan.

use crate::failure::Failure;
use evpr_core::Plan;
use evpr_core::config::{self, Config, Overrides};
use evpr_core::plan::{Catalog, Model, Models, Sensor};
use evpr_onnx::Registry;
use std::path::Path;

/// The reconstructions and extractors of this executable, without networks.
pub(crate) const CATALOG: Catalog<'static> = Catalog {
    reconstructions: &evpr_reconstruct::ALL_KINDS,
    extractors: &evpr_extract::KINDS,
    models: Models::NONE,
    cores: 1,
};

/// A registry of models, as messages name it.
pub(crate) struct Networks {
    registry: Registry,
    name: String,
}

impl Networks {
    /// Those of a registry; none when it is not there.
    pub(crate) fn read(path: &Path) -> Result<Self, Failure> {
        let found = Registry::read(path)?;
        let name = match &found {
            Some(_) => path.display().to_string(),
            None => format!(
                "{}, which is not there: make it with scripts/export_models.py, or name another one",
                path.display()
            ),
        };
        let registry = found.unwrap_or_default();
        let built_in = |id: &str| {
            let reconstructions = CATALOG.reconstructions.iter().map(|kind| kind.name);
            let extractors = CATALOG.extractors.iter().map(|kind| kind.name);
            reconstructions.chain(extractors).any(|name| name == id)
        };
        if let Some(model) = registry.models.iter().find(|model| built_in(&model.id)) {
            return Err(Failure::new(format!(
                "{name}: model \"{}\" has the name of a built-in kind; give it another id",
                model.id
            )));
        }
        Ok(Self { registry, name })
    }

    /// The models, in the registry's order.
    pub(crate) fn models(&self) -> &[Model] {
        &self.registry.models
    }

    /// The registry, and that it is not there if it is not.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// The executable's kinds and these networks.
    pub(crate) fn catalog(&self) -> Catalog<'_> {
        Catalog {
            models: Models {
                models: &self.registry.models,
                registry: &self.name,
            },
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            ..CATALOG
        }
    }
}

/// Checks the text of a configuration, and reads the registry of models that it names; `file` is for messages.
pub(crate) fn parse(text: &str, file: &str) -> Result<Config, Failure> {
    let networks = Networks::read(&config::registry_path(text))?;
    config::parse(text, file, &networks.catalog()).map_err(Failure::new)
}

/// Reads and checks a configuration.
pub(crate) fn load(path: &Path) -> Result<Config, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|e| Failure::new(format!("cannot read the configuration {}: {e}", path.display())))?;
    parse(&text, &path.display().to_string())
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
        None if config.source(overrides).is_none() => Sensor { height: 1, width: 1 },
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
