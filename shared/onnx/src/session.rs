//! A model's file becomes a session: its hash is checked, a provider found, and what it says of itself compared with
//! the registry.

use crate::describe::Facts;
use crate::error::{OnnxError, one_line};
use crate::library::Library;
use crate::memory;
use crate::registry::hex_sha256;
use evpr_core::plan::{Inference, Model, Network, Provider, Sensor};
use ort::ep::{self, ExecutionProvider, ExecutionProviderDispatch};
use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::{TensorElementType, ValueType};
use std::fs::File;
use std::io::Read;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tracing::{debug, info, warn};

/// What loading a network came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Loaded {
    /// The provider that computes it.
    pub provider: Provider,
    /// What its file says of itself.
    pub facts: Facts,
    /// How long it took to check and load it.
    pub took: Duration,
}

/// A model that is loaded.
pub(crate) struct Opened {
    pub(crate) session: Session,
    pub(crate) loaded: Loaded,
    pub(crate) inputs: Vec<Tensor>,
    pub(crate) outputs: Vec<Tensor>,
}

/// A tensor that a network takes or gives.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Tensor {
    pub(crate) name: String,
    /// Its lengths; none for one that is not f32.
    pub(crate) dims: Option<Vec<Dim>>,
}

/// A length of a tensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Dim {
    Fixed(usize),
    /// Any, under this name.
    Free(String),
}

impl Dim {
    /// Whether it can be this long.
    pub(crate) fn allows(&self, length: usize) -> bool {
        match self {
            Dim::Fixed(fixed) => *fixed == length,
            Dim::Free(_) => true,
        }
    }
}

impl std::fmt::Display for Tensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Some(dims) = &self.dims else {
            return write!(f, "{} (not of f32)", self.name);
        };
        let dims = dims.iter().map(|dim| match dim {
            Dim::Fixed(length) => length.to_string(),
            Dim::Free(name) if name.is_empty() => "?".to_owned(),
            Dim::Free(name) => name.clone(),
        });
        write!(f, "{} [{}]", self.name, dims.collect::<Vec<_>>().join(", "))
    }
}

/// Rows and columns of the frames that a network takes where no sensor says it: those that its file fixes, else these.
const ANY_FRAME: Sensor = Sensor {
    height: 260,
    width: 346,
};

impl Opened {
    /// The size of frames for the network: the sensor's, or the one that its only input of four lengths fixes.
    pub(crate) fn frame(&self, sensor: Option<Sensor>) -> Sensor {
        let fixed = self.inputs.iter().find_map(|input| match input.dims.as_deref() {
            Some([_, _, Dim::Fixed(height), Dim::Fixed(width)]) => Some(Sensor {
                height: *height,
                width: *width,
            }),
            _ => None,
        });
        sensor.or(fixed).unwrap_or(ANY_FRAME)
    }
}

fn tensor(outlet: &ort::value::Outlet) -> Tensor {
    let dims = match outlet.dtype() {
        ValueType::Tensor {
            ty: TensorElementType::Float32,
            shape,
            dimension_symbols,
        } => Some(
            shape
                .iter()
                .enumerate()
                .map(|(i, length)| match usize::try_from(*length) {
                    Ok(length) => Dim::Fixed(length),
                    Err(_) => Dim::Free(dimension_symbols.get(i).cloned().unwrap_or_default()),
                })
                .collect(),
        ),
        _ => None,
    };
    Tensor {
        name: outlet.name().to_owned(),
        dims,
    }
}

/// So many numbers to compute something of, from −1 to 1: neither constant nor the same in every channel.
pub fn pattern(numbers: usize) -> Vec<f32> {
    (0..numbers)
        .map(|i| ((i * 7919) % 1024) as f32 / 512.0 - 1.0)
        .collect()
}

/// An error about the model's file.
pub(crate) fn wrong_model(model: &Model, problem: String) -> OnnxError {
    OnnxError::Model {
        id: model.id.clone(),
        path: model.file.clone(),
        problem,
    }
}

/// Checks a model's file and loads it.
pub(crate) fn open(library: &Library, network: &Network, inference: &Inference) -> Result<Opened, OnnxError> {
    let started = Instant::now();
    let model = &network.model;
    let bytes = read_file(model)?;
    let (session, provider) = start(library, network, inference, &bytes)?;
    drop(bytes);
    let facts = Facts::of(&session);
    if let Some(problem) = facts.contradiction(model) {
        return Err(wrong_model(model, problem));
    }
    let opened = Opened {
        inputs: session.inputs().iter().map(tensor).collect(),
        outputs: session.outputs().iter().map(tensor).collect(),
        session,
        loaded: Loaded {
            provider,
            facts,
            took: started.elapsed(),
        },
    };
    debug!(
        model = model.id,
        provider = provider.name(),
        threads = network.threads,
        took_ms = opened.loaded.took.as_millis() as u64,
        library = %library.path().display(),
        "network loaded"
    );
    Ok(opened)
}

/// Reads the file: it is there, fits into memory, and is the registry's.
fn read_file(model: &Model) -> Result<Vec<u8>, OnnxError> {
    let wrong = |problem: String| wrong_model(model, problem);
    let found = std::fs::metadata(&model.file).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => wrong(format!(
            "there is no such file; {}",
            match model.source.as_str() {
                "" => "put it there, or correct the registry".to_owned(),
                source => format!("put it there (its weights: {source}), or correct the registry"),
            }
        )),
        _ => wrong(format!("cannot be read: {e}")),
    })?;
    if !found.is_file() {
        return Err(wrong("is no file; correct the registry".to_owned()));
    }
    memory::check(found.len(), memory::available()).map_err(wrong)?;
    let mut bytes = Vec::new();
    let length = usize::try_from(found.len()).unwrap_or(usize::MAX);
    bytes
        .try_reserve_exact(length)
        .map_err(|_| wrong(format!("there is no memory for its {} MiB", found.len() >> 20)))?;
    let read = File::open(&model.file).and_then(|file| file.take(found.len()).read_to_end(&mut bytes));
    read.map_err(|e| wrong(format!("cannot be read: {e}")))?;
    let hash = hex_sha256(&bytes);
    if hash != model.sha256 {
        return Err(wrong(format!(
            "its SHA-256 is {}…, and the registry's {}…: it is cut short or another file; fetch or export it again, or \
             correct the registry",
            &hash[..12],
            &model.sha256[..12.min(model.sha256.len())]
        )));
    }
    Ok(bytes)
}

/// Starts the first provider that can.
fn start(
    library: &Library,
    network: &Network,
    inference: &Inference,
    bytes: &[u8],
) -> Result<(Session, Provider), OnnxError> {
    let model = &network.model;
    let mut last = None;
    for (index, provider) in inference.providers.iter().copied().enumerate() {
        match session(library, network, inference, bytes, provider) {
            Ok(session) => return Ok((session, provider)),
            Err(error) if !inference.fallback || index + 1 == inference.providers.len() => return Err(error),
            Err(error) => {
                warn!(
                    model = model.id,
                    "the provider \"{}\" cannot start, taking \"{}\": {}",
                    provider.name(),
                    inference.providers[index + 1].name(),
                    error.problem()
                );
                last = Some(error);
            }
        }
    }
    Err(last.unwrap_or_else(|| {
        wrong_model(
            model,
            "no provider is named; write inference.providers".to_owned(),
        )
    }))
}

fn session(
    library: &Library,
    network: &Network,
    inference: &Inference,
    bytes: &[u8],
    provider: Provider,
) -> Result<Session, OnnxError> {
    let model = &network.model;
    let cannot_start = |e: &dyn std::fmt::Display| OnnxError::Provider {
        id: model.id.clone(),
        provider: provider.name(),
        problem: one_line(e),
    };
    if !is_there(provider).map_err(|e| cannot_start(&e))? {
        return Err(cannot_start(&"this library of ONNX Runtime was built without it"));
    }
    let engines = engine_cache(model, provider)?;
    // XNNPACK has threads of its own.
    let threads = if provider == Provider::Xnnpack {
        1
    } else {
        network.threads
    };
    let mut builder = Session::builder(&library.environment)
        .map_err(|e| cannot_start(&e))?
        .with_optimization_level(GraphOptimizationLevel::All)
        .map_err(|e| cannot_start(&e))?
        .with_intra_threads(threads)
        .map_err(|e| cannot_start(&e))?
        .with_intra_op_spinning(inference.spinning)
        .map_err(|e| cannot_start(&e))?;
    if let Some(dispatch) = dispatch(provider, network, engines.as_deref()) {
        builder = builder
            .with_execution_providers([dispatch.error_on_failure()])
            .map_err(|e| cannot_start(&e))?;
    }
    builder.commit_from_memory(bytes).map_err(|e| match provider {
        Provider::Cpu => wrong_model(
            model,
            format!("ONNX Runtime cannot load it: {}; export it again", one_line(&e)),
        ),
        _ => cannot_start(&e),
    })
}

/// Whether the library has this provider.
fn is_there(provider: Provider) -> ort::Result<bool> {
    match provider {
        Provider::Cpu => Ok(true),
        Provider::Cuda => ep::CUDA::is_available(),
        Provider::Xnnpack => ep::XNNPACK::is_available(),
        Provider::Tensorrt => ep::TensorRT::is_available(),
        Provider::Openvino => ep::OpenVINO::is_available(),
    }
}

/// The provider as ONNX Runtime wants it; none for its own kernels on the CPU, which are always there.
fn dispatch(
    provider: Provider,
    network: &Network,
    engines: Option<&Path>,
) -> Option<ExecutionProviderDispatch> {
    let engines = engines.map(|path| path.display().to_string());
    let threads = NonZeroUsize::new(network.threads).unwrap_or(NonZeroUsize::MIN);
    Some(match provider {
        Provider::Cpu => return None,
        Provider::Cuda => ep::CUDA::default().build(),
        Provider::Xnnpack => ep::XNNPACK::default().with_intra_op_num_threads(threads).build(),
        Provider::Tensorrt => {
            let tensorrt = ep::TensorRT::default();
            match engines {
                Some(engines) => tensorrt
                    .with_engine_cache(true)
                    .with_engine_cache_path(&engines)
                    .with_timing_cache(true)
                    .with_timing_cache_path(engines)
                    .build(),
                None => tensorrt.build(),
            }
        }
        Provider::Openvino => {
            let openvino = ep::OpenVINO::default().with_num_threads(threads.get());
            match engines {
                Some(engines) => openvino.with_cache_dir(engines).build(),
                None => openvino.build(),
            }
        }
    })
}

/// The folder beside the model where a provider keeps what it compiles of it; none for those that compile nothing.
/// Says so when there is nothing yet, as compiling takes its time.
fn engine_cache(model: &Model, provider: Provider) -> Result<Option<PathBuf>, OnnxError> {
    if !matches!(provider, Provider::Tensorrt | Provider::Openvino) {
        return Ok(None);
    }
    let name = format!("{}-{}", model.id, &model.sha256[..12.min(model.sha256.len())]);
    let folder = model.file.parent().unwrap_or(Path::new(""));
    let cache = folder.join(format!("{}-engines", provider.name())).join(name);
    std::fs::create_dir_all(&cache).map_err(|e| {
        wrong_model(
            model,
            format!(
                "the folder of its engines, {}, cannot be made: {e}",
                cache.display()
            ),
        )
    })?;
    let empty = std::fs::read_dir(&cache).is_ok_and(|mut entries| entries.next().is_none());
    if empty {
        info!(
            model = model.id,
            provider = provider.name(),
            folder = %cache.display(),
            "compiling the network for this machine, once; this can take minutes"
        );
    }
    Ok(Some(cache))
}
