//! `evpr demo`.

use crate::args::DemoArgs;
use crate::demo::folder::{self, ReportFolder};
use crate::demo::frames;
use crate::demo::graph::{Drive, Driven, Signals, drive};
use crate::demo::latency;
use crate::demo::matrix::{self, ScoreMatrix};
use crate::demo::page;
use crate::demo::pictures;
use crate::demo::recall::{self, Recorded};
use crate::demo::results::{PassResult, Results, Scene};
use crate::demo::setup::{CONFIG_NAME, Setup};
use crate::failure::Failure;
use crate::output::say;
use evpr_core::Plan;
use evpr_core::plan::StreetPass;
use std::process::ExitCode;
use std::time::Instant;

/// The drives that are recognised.
const QUERIES: [StreetPass; 2] = [StreetPass::Day2, StreetPass::Night];

/// Simulates, maps, recognises, evaluates, and writes the report.
pub(crate) fn demo(args: &DemoArgs) -> Result<ExitCode, Failure> {
    let start = Instant::now();
    let show = Show { quiet: args.quiet };
    let setup = Setup {
        seed: args.seed,
        quick: args.quick,
    };
    let folder = ReportFolder::create(&args.out)?;
    folder.write(CONFIG_NAME, &setup.config())?;

    let driven = match drive_all(&setup, &folder, show)? {
        Ok(driven) => driven,
        Err(cut_short) => return Ok(cut_short),
    };
    show.step("evaluating every ensemble");
    let evaluated = evaluate(&driven)?;
    let scene = Scene::of(&driven.queries[0].plan, args.seed, args.quick)?;
    let mut results = Results::new(scene, evaluated.passes, evaluated.recall, driven.latency);

    show.step("drawing the report");
    let place = look(&setup, &folder, &driven.queries)?;
    pictures::frames::draw(&folder.file(folder::FRAMES), &place)?;
    pictures::recall::draw(&folder.file(folder::RECALL), &results)?;
    pictures::latency::draw(&folder.file(folder::LATENCY), &results.latency)?;
    let files = [folder::SIMILARITY_DAY, folder::SIMILARITY_NIGHT];
    for ((file, recorded), matrix) in files.into_iter().zip(&driven.queries).zip(&evaluated.matrices) {
        pictures::similarity::draw(&folder.file(file), recorded, matrix)?;
    }
    results.took_s = start.elapsed().as_secs_f64();
    folder.write(folder::PAGE, &page::write(&results, &place))?;
    let json = serde_json::to_string_pretty(&results)?;
    folder.write(folder::RESULTS, &json)?;

    if args.json {
        say!("{json}");
    } else {
        results.show();
    }
    show.step(&format!(
        "the report is {} ({:.0} s)",
        folder.file(folder::PAGE).display(),
        results.took_s
    ));
    Ok(ExitCode::SUCCESS)
}

/// What is said while it works.
#[derive(Debug, Clone, Copy)]
struct Show {
    quiet: bool,
}

impl Show {
    fn step(self, what: &str) {
        if !self.quiet {
            eprintln!("{what}");
        }
    }
}

/// What the drives left.
struct DrivenAll {
    mapped: PassResult,
    /// Per drive of [`QUERIES`]: its rows with the map, and what the graph did.
    queries: Vec<Recorded>,
    drives: Vec<Drive>,
    latency: latency::Latency,
}

/// All drives through the graph, or with what the command ends when one of them was cut short.
fn drive_all(
    setup: &Setup,
    folder: &ReportFolder,
    show: Show,
) -> Result<Result<DrivenAll, ExitCode>, Failure> {
    let map = folder.traverse(StreetPass::Day);
    let signals = Signals::take()?;
    let run = |plan: &Plan, matches: Option<StreetPass>, what: &str| {
        show.step(what);
        let matches = matches.map(|pass| folder.matches(pass));
        drive(&signals, plan, matches.as_deref(), show.quiet, "  ")
    };
    let mapping = setup.mapping(&map)?;
    let mapped = match run(&mapping, None, "mapping the street by day")? {
        Driven::Whole(drive) => drive,
        Driven::CutShort(code) => return Ok(Err(code)),
    };
    let mapped = PassResult {
        pass: StreetPass::Day,
        ticks: evpr_store::Traverse::open(&map)?.len(),
        events: mapped.events(),
        took_s: mapped.took_s,
        equal_answers: None,
    };
    let (mut queries, mut drives) = (Vec::new(), Vec::new());
    for (pass, what) in QUERIES
        .into_iter()
        .zip(["recognising it by day again", "recognising it by night"])
    {
        let record = folder.traverse(pass);
        let plan = setup.matching(pass, &map, &record)?;
        match run(&plan, Some(pass), what)? {
            Driven::Whole(drive) => drives.push(drive),
            Driven::CutShort(code) => return Ok(Err(code)),
        }
        queries.push(Recorded::open(&plan, pass, &record)?);
    }
    let paced = setup.paced(&map)?;
    let latency = match run(&paced, None, "measuring latency in real time")? {
        Driven::Whole(drive) => {
            latency::measure(&drive, paced.members.len(), paced.slicing.tick as f64 / 1e9)
        }
        Driven::CutShort(code) => return Ok(Err(code)),
    };
    Ok(Ok(DrivenAll {
        mapped,
        queries,
        drives,
        latency,
    }))
}

/// What the recorded rows say.
struct Evaluated {
    passes: Vec<PassResult>,
    recall: Vec<recall::KindRecall>,
    /// Fused scores per drive of [`QUERIES`].
    matrices: Vec<ScoreMatrix>,
}

fn evaluate(driven: &DrivenAll) -> Result<Evaluated, Failure> {
    let mut evaluated = Evaluated {
        passes: vec![driven.mapped.clone()],
        recall: Vec::new(),
        matrices: Vec::new(),
    };
    for (recorded, drive) in driven.queries.iter().zip(&driven.drives) {
        let matrix = matrix::fused(recorded)?;
        let answered = drive.answers.iter().map(|h| usize::try_from(h.reference).ok());
        let equal = answered
            .zip(&matrix.answers)
            .filter(|(live, later)| live == *later)
            .count();
        evaluated.passes.push(PassResult {
            pass: recorded.pass,
            ticks: recorded.query.ticks.len(),
            events: drive.events(),
            took_s: drive.took_s,
            equal_answers: Some(equal),
        });
        evaluated.matrices.push(matrix);
        for length in [recorded.plan.fuse.length, 1] {
            evaluated.recall.extend(recall::measure(recorded, length)?);
        }
    }
    Ok(evaluated)
}

/// Frames of every method at one place on all drives.
fn look(setup: &Setup, folder: &ReportFolder, queries: &[Recorded]) -> Result<frames::Place, Failure> {
    let mapping = setup.mapping(&folder.traverse(StreetPass::Day))?;
    let queries: Vec<_> = queries.iter().map(|q| (q.pass, &q.plan, &q.positions)).collect();
    frames::look(&mapping, &queries)
}
