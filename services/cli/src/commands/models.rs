//! `evpr models`: the registry of models, whether its networks can be used, and how fast they are.

use crate::args::{ModelsArgs, ModelsBenchArgs, ModelsCheckArgs, ModelsCommand, ModelsListArgs};
use crate::catalog::Networks;
use crate::commands::parse_sensor;
use crate::failure::Failure;
use crate::output::say;
use evpr_core::plan::{Inference, Model, ModelKind, Network, Provider, Sensor};
use evpr_onnx::{DescriptorNetwork, FrameNetwork, Library, Loaded, OnnxError, State, pattern, peak_gmacs};
use serde::Serialize;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Metadata of a model's file: thousands of millions of multiplications with additions per image.
const GMACS: &str = "gmacs";

/// `evpr models`.
pub(crate) fn models(command: &ModelsCommand) -> Result<ExitCode, Failure> {
    match command {
        ModelsCommand::List(args) => list(args),
        ModelsCommand::Check(args) => check(args),
        ModelsCommand::Bench(args) => bench(args),
    }
}

/// The models that were named, or all.
fn chosen(args: &ModelsArgs) -> Result<Vec<Model>, Failure> {
    let networks = Networks::read(&args.models)?;
    let models = networks.models();
    if models.is_empty() {
        return Err(Failure::new(format!(
            "no networks: those there are are those of {}",
            networks.name()
        )));
    }
    if args.ids.is_empty() {
        return Ok(models.to_vec());
    }
    let find = |id: &String| {
        let found = models.iter().find(|model| model.id == *id);
        found.cloned().ok_or_else(|| {
            let all: Vec<&str> = models.iter().map(|model| model.id.as_str()).collect();
            Failure::usage(format!(
                "{id}: {} has no such model; it has {}",
                networks.name(),
                all.join(", ")
            ))
        })
    };
    args.ids.iter().map(find).collect()
}

#[derive(Debug, Serialize)]
struct ListRow<'a> {
    id: &'a str,
    kind: &'static str,
    /// Length of a descriptor, or bins of a voxel grid.
    output: String,
    input: String,
    file: String,
    /// Bytes; none where there is no file.
    bytes: Option<u64>,
    licence: &'a str,
    source: &'a str,
}

fn row(model: &Model) -> ListRow<'_> {
    let (kind, output, input) = match &model.kind {
        ModelKind::Extractor {
            preprocessing,
            dimension,
        } => (
            "extractor",
            format!("{dimension} numbers"),
            preprocessing.input.to_string(),
        ),
        ModelKind::Reconstruction { bins, states, .. } => {
            let memory = if states.is_empty() { "" } else { ", with a memory" };
            (
                "reconstruction",
                "grey frames".to_owned(),
                format!("{bins} bins{memory}"),
            )
        }
    };
    ListRow {
        id: &model.id,
        kind,
        output,
        input,
        file: model.file.display().to_string(),
        bytes: std::fs::metadata(&model.file).ok().map(|m| m.len()),
        licence: &model.licence,
        source: &model.source,
    }
}

fn list(args: &ModelsListArgs) -> Result<ExitCode, Failure> {
    let models = chosen(&args.which)?;
    let rows: Vec<ListRow<'_>> = models.iter().map(row).collect();
    if args.which.json {
        say!("{}", serde_json::to_string_pretty(&rows)?);
        return Ok(ExitCode::SUCCESS);
    }
    let widest = rows.iter().map(|row| row.id.len()).max().unwrap_or(0);
    for row in rows {
        let size = match row.bytes {
            Some(bytes) => format!("{:.1} MB", bytes as f64 / 1e6),
            None => "no file".to_owned(),
        };
        say!(
            "{:<widest$}  {:<14}  {:>9}  {} → {}",
            row.id,
            row.kind,
            size,
            row.input,
            row.output
        );
        say!(
            "{:<widest$}  {}; licence: {}",
            "",
            row.file,
            or_unknown(row.licence)
        );
        say!("{:<widest$}  weights: {}", "", or_unknown(row.source));
    }
    Ok(ExitCode::SUCCESS)
}

fn or_unknown(text: &str) -> &str {
    if text.is_empty() { "not said" } else { text }
}

/// A network that is loaded, whichever it is.
enum Ready {
    Extractor(Box<DescriptorNetwork>),
    Reconstruction(Box<FrameNetwork>),
}

impl Ready {
    fn load(
        library: &Library,
        network: &Network,
        inference: &Inference,
        sensor: Option<Sensor>,
    ) -> Result<Self, OnnxError> {
        Ok(match network.model.kind {
            ModelKind::Extractor { .. } => Self::Extractor(Box::new(DescriptorNetwork::load(
                library, network, inference, sensor, 1,
            )?)),
            ModelKind::Reconstruction { .. } => {
                Self::Reconstruction(Box::new(FrameNetwork::load(library, network, inference, sensor)?))
            }
        })
    }

    fn loaded(&self) -> &Loaded {
        match self {
            Self::Extractor(network) => network.loaded(),
            Self::Reconstruction(network) => network.loaded(),
        }
    }

    /// Channels (or bins), height and width.
    fn input_shape(&self) -> (usize, usize, usize) {
        match self {
            Self::Extractor(network) => network.input_shape(),
            Self::Reconstruction(network) => network.input_shape(),
        }
    }

    /// Computes `count` images; input of a reconstruction has one.
    fn run(&mut self, input: &[f32], count: usize) -> Result<(), OnnxError> {
        match self {
            Self::Extractor(network) => network.run(input, count).map(|_| ()),
            Self::Reconstruction(network) => network.run(input, &mut State::default(), &mut |_| {}),
        }
    }
}

#[derive(Debug, Serialize)]
struct CheckRow {
    id: String,
    ok: bool,
    /// What was found, or what is wrong.
    found: String,
    load_ms: Option<f64>,
}

fn check_one(library: &Library, model: &Model, inference: &Inference, sensor: Option<Sensor>) -> CheckRow {
    let network = Network {
        model: model.clone(),
        threads: 1,
        batch: None,
    };
    let checked = Ready::load(library, &network, inference, sensor).map(|ready| {
        let (channels, height, width) = ready.input_shape();
        (format!("{channels}×{height}×{width}"), ready.loaded().clone())
    });
    match checked {
        Ok((shape, loaded)) => CheckRow {
            id: model.id.clone(),
            ok: true,
            found: format!("{shape} on {}", loaded.provider.name()),
            load_ms: Some(loaded.took.as_secs_f64() * 1e3),
        },
        Err(e) => CheckRow {
            id: model.id.clone(),
            ok: false,
            found: e.to_string(),
            load_ms: None,
        },
    }
}

fn check(args: &ModelsCheckArgs) -> Result<ExitCode, Failure> {
    let models = chosen(&args.which)?;
    let sensor = args.run.sensor.as_deref().map(parse_sensor).transpose()?;
    let inference = args.run.inference();
    let library = Library::load(inference.library.as_deref())?;
    let rows = models
        .iter()
        .map(|model| check_one(&library, model, &inference, sensor));
    let mut good = true;
    let mut all = Vec::new();
    for row in rows {
        good &= row.ok;
        if !args.which.json {
            match row.load_ms {
                Some(ms) => say!("ok     {}: {}, loaded in {ms:.0} ms", row.id, row.found),
                None => say!("WRONG  {}", row.found),
            }
        }
        all.push(row);
    }
    if args.which.json {
        say!("{}", serde_json::to_string_pretty(&all)?);
    }
    Ok(if good {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

#[derive(Debug, Serialize)]
struct BenchRow {
    id: String,
    provider: &'static str,
    threads: usize,
    batch: usize,
    spinning: bool,
    /// Per image.
    p50_ms: f64,
    least_ms: f64,
    images: usize,
    /// What its multiplications take at the speed of a matrix product; none where the file does not say how many.
    floor_ms: Option<f64>,
}

/// Computes for a while: milliseconds per image.
fn time(ready: &mut Ready, batch: usize, period: Duration) -> Result<Vec<f64>, OnnxError> {
    let (channels, height, width) = ready.input_shape();
    let input = pattern(batch * channels * height * width);
    ready.run(&input, batch)?;
    let mut times = Vec::new();
    let begun = Instant::now();
    while times.len() < 3 || begun.elapsed() < period {
        let started = Instant::now();
        ready.run(&input, batch)?;
        times.push(started.elapsed().as_secs_f64() * 1e3 / batch as f64);
    }
    times.sort_by(f64::total_cmp);
    Ok(times)
}

fn bench(args: &ModelsBenchArgs) -> Result<ExitCode, Failure> {
    let models = chosen(&args.which)?;
    let sensor = args.run.sensor.as_deref().map(parse_sensor).transpose()?;
    let inference = args.run.inference();
    let library = Library::load(inference.library.as_deref())?;
    let mut rows = Vec::new();
    let mut good = true;
    if !args.which.json {
        say!(
            "{:<20} {:>9} {:>7} {:>5} {:>10} {:>10} {:>10} {:>7}",
            "model",
            "provider",
            "threads",
            "batch",
            "p50 ms",
            "least ms",
            "floor ms",
            "floor"
        );
    }
    for threads in args.threads.iter().copied() {
        let peak = peak_gmacs(&library, threads, inference.spinning)?;
        for model in &models {
            for batch in args.batch.iter().copied() {
                // A reconstruction computes one frame after the other.
                if batch > 1 && matches!(model.kind, ModelKind::Reconstruction { .. }) {
                    continue;
                }
                for provider in inference.providers.iter().copied() {
                    let network = Network {
                        model: model.clone(),
                        threads,
                        batch: Some(batch),
                    };
                    let one = Inference {
                        providers: vec![provider],
                        ..inference.clone()
                    };
                    match bench_one(&library, &network, &one, sensor, args, peak) {
                        Ok(row) => {
                            if !args.which.json {
                                print(&row);
                            }
                            rows.push(row);
                        }
                        // The others can be timed all the same.
                        Err(e) => {
                            good = false;
                            eprintln!("error: {e}");
                        }
                    }
                }
            }
        }
    }
    if args.which.json {
        say!("{}", serde_json::to_string_pretty(&rows)?);
    } else {
        say!(
            "per image; floor: its multiplications at the speed of a matrix product on as many threads of the CPU"
        );
    }
    Ok(if good {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn bench_one(
    library: &Library,
    network: &Network,
    inference: &Inference,
    sensor: Option<Sensor>,
    args: &ModelsBenchArgs,
    peak: f64,
) -> Result<BenchRow, OnnxError> {
    let batch = network.batch.unwrap_or(1);
    let mut ready = Ready::load(library, network, inference, sensor)?;
    let gmacs: Option<f64> = ready
        .loaded()
        .facts
        .0
        .get(GMACS)
        .and_then(|text| text.parse().ok());
    let provider = ready.loaded().provider;
    let times = time(&mut ready, batch, Duration::from_secs_f64(args.seconds))?;
    let on_cpu = matches!(provider, Provider::Cpu | Provider::Xnnpack | Provider::Openvino);
    Ok(BenchRow {
        id: network.model.id.clone(),
        provider: provider.name(),
        threads: network.threads,
        batch,
        spinning: inference.spinning,
        p50_ms: times[times.len() / 2],
        least_ms: times[0],
        images: times.len() * batch,
        floor_ms: gmacs.filter(|_| on_cpu).map(|gmacs| gmacs / peak * 1e3),
    })
}

fn print(row: &BenchRow) {
    let (floor, part) = match row.floor_ms {
        Some(floor) => (
            format!("{floor:.2}"),
            format!("{:.0} %", 100.0 * floor / row.p50_ms),
        ),
        None => ("-".to_owned(), "-".to_owned()),
    };
    say!(
        "{:<20} {:>9} {:>7} {:>5} {:>10.2} {:>10.2} {:>10} {:>7}",
        row.id,
        row.provider,
        row.threads,
        row.batch,
        row.p50_ms,
        row.least_ms,
        floor,
        part
    );
}
