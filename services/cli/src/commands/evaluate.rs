//! `evpr evaluate`: recall of recorded traverses, over subsets, methods, lengths and rules at once.

use crate::args::EvaluateArgs;
use crate::catalog;
use crate::failure::Failure;
use crate::figure;
use crate::output::say;
use crate::query_frames::show_frames;
use crate::study::Study;
use evpr_core::config::{SIMILARITIES, parse_method, parse_rule};
use evpr_evaluate::choose::Costs;
use evpr_evaluate::report::{Picture, Report, check_costs, looks};
use evpr_evaluate::statistics::{Members, comparisons, members};
use evpr_evaluate::{
    LearntWeights, Pair, PairSpec, PairsFile, Progress, Results, Row, Spec, SubsetChoice, SubsetKind, Truth,
    evaluate as run, learnt_weights, read_weights,
};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use std::io::IsTerminal;
use std::path::Path;
use std::process::ExitCode;

/// Where the report's figures lie in its folder.
const FIGURES: &str = "figures";
/// Most lines of the table.
const MAX_LINES: usize = 60;

/// `evpr evaluate`.
pub(crate) fn evaluate(args: &EvaluateArgs) -> Result<ExitCode, Failure> {
    let Opened { pairs, named, study } = open_pairs(&args.pairs, args.quiet)?;
    let spec = spec(args, &named, study.as_ref())?;
    let inputs: Vec<&Path> = args.pairs.folders();
    crate::output::refuse_input(&args.out, &inputs)?;
    let teacher = args
        .learn_weights
        .as_deref()
        .map(|name| pair_named(&pairs, name))
        .transpose()?;
    let given = args.weights.as_deref();
    let given = given.map(|path| read_weights(path, &pairs)).transpose()?;
    // What else is read is read first: a mistake in it must not cost the time of an evaluation.
    let costs = args.costs.as_deref().map(Costs::read).transpose()?;
    if let Some(costs) = &costs {
        check_costs(&pairs, costs)?;
    }
    if let Some(config) = &args.config {
        catalog::load(config)?;
    }
    let mut results = Results::open(&args.out, &pairs)?;
    let before = results.rows().len();
    let progress = Bar::new(args.quiet);
    let evaluated = run(&pairs, &spec, &mut results, &progress).map_err(Failure::from);
    let evaluated = evaluated.and_then(|()| match given {
        Some(given) => {
            let weighted = Spec {
                weights: Some(given),
                ..spec.clone()
            };
            Ok(run(&pairs, &weighted, &mut results, &progress)?)
        }
        None => Ok(()),
    });
    let evaluated = evaluated.and_then(|()| match teacher {
        Some(teacher) => weigh(&pairs, teacher, &spec, &mut results, &progress),
        None => Ok(()),
    });
    progress.bar.finish_and_clear();
    evaluated?;
    let compared = comparisons(results.rows());
    results.write_statistics(&compared)?;
    if let Some(wanted) = args.wanted_precision {
        results.write_thresholds(wanted)?;
    }
    let alike: Vec<Members> = if args.likeness {
        let alike: Result<_, _> = pairs.iter().map(|pair| members(pair, &spec)).collect();
        alike?
    } else {
        Vec::new()
    };
    if args.likeness {
        results.write_members(&alike)?;
    }
    let mut looked = looks(&pairs, results.rows(), &spec)?;
    if let Some(config) = &args.config {
        for look in &mut looked {
            show_frames(look, &pairs, config);
        }
    }
    let figures = results.write_report(&Report {
        pairs: &pairs,
        spec: &spec,
        looks: &looked,
        comparisons: &compared,
        members: &alike,
        costs: costs.as_ref(),
    })?;
    draw(&args.out.join(FIGURES), &figures)?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(results.rows())?);
    } else if !args.quiet {
        show(results.rows());
        let rows = results.rows().len();
        eprintln!(
            "{}: {rows} configurations, {} of them new",
            args.out.join("report.html").display(),
            rows - before
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// Draws all figures into a folder.
fn draw(folder: &Path, figures: &[Picture]) -> Result<(), Failure> {
    std::fs::create_dir_all(folder)
        .map_err(|e| Failure::new(format!("{}: cannot be made: {e}", folder.display())))?;
    figures
        .par_iter()
        .try_for_each(|picture| figure::draw(&folder.join(&picture.name).with_extension("png"), picture))
}

/// The pair of this name.
fn pair_named<'a>(pairs: &'a [Pair], name: &str) -> Result<&'a Pair, Failure> {
    let names = || pairs.iter().map(Pair::name).collect::<Vec<_>>().join(", ");
    let found = pairs.iter().find(|p| p.name() == name);
    found.ok_or_else(|| {
        Failure::usage(format!(
            "--learn-weights {name}: no pair is named so; there are {}",
            names()
        ))
    })
}

/// Learns weights on a pair, for every similarity, method and length by themselves, and evaluates all pairs with them.
fn weigh(
    pairs: &[Pair],
    pair: &Pair,
    spec: &Spec,
    results: &mut Results,
    progress: &Bar,
) -> Result<(), Failure> {
    let mut seen = Vec::new();
    let mut learnt = Vec::new();
    for c in spec.configurations(pair.members())? {
        if seen.contains(&(c.similarity, c.method, c.length)) {
            continue;
        }
        seen.push((c.similarity, c.method, c.length));
        let key = c.key(pair.name());
        let like = results.rows().iter().find(|r| r.key == key).cloned();
        let like = like.ok_or_else(|| Failure::new(format!("{key} was not evaluated")))?;
        let weights = learnt_weights(pair, results.rows(), &like)?;
        let weighted = Spec {
            similarities: vec![c.similarity],
            methods: vec![c.method],
            lengths: vec![c.length],
            weights: Some((format!("learnt:{}", pair.name()), weights.clone())),
            ..spec.clone()
        };
        run(pairs, &weighted, results, progress)?;
        learnt.push(LearntWeights {
            pair: pair.name().to_owned(),
            similarity: like.similarity,
            method: like.method,
            length: like.length,
            weights,
        });
    }
    Ok(results.write_weights(&learnt)?)
}

/// What was asked for.
pub(crate) struct Opened {
    pub(crate) pairs: Vec<Pair>,
    /// Subsets that have a name.
    named: Vec<SubsetChoice>,
    /// What else is asked for, where the pairs are those of a study.
    study: Option<Study>,
}

/// Opens all pairs that were asked for.
pub(crate) fn open_pairs(args: &crate::args::PairArgs, quiet: bool) -> Result<Opened, Failure> {
    let study = args.pairs.as_deref().map(Study::find).transpose()?.flatten();
    let file = match (&args.pairs, &args.reference, &args.query, &args.ground_truth) {
        (Some(path), ..) => match &study {
            None => PairsFile::read(path)?,
            Some(study) => {
                let (pairs, missing) = study.pairs()?;
                missing.iter().for_each(|m| eprintln!("left out: {m}"));
                PairsFile {
                    conditions: pairs.iter().filter_map(crate::study::condition).collect(),
                    pairs,
                    ..PairsFile::default()
                }
            }
        },
        (None, Some(reference), Some(query), Some(truth)) => {
            let truth = if truth.as_os_str() == "positions" {
                Truth::Positions {
                    tolerance_m: args.tolerance_m,
                }
            } else {
                Truth::File {
                    path: truth.clone(),
                    tolerance_frames: args.tolerance_frames,
                    orientation: args.orientation.map(Into::into),
                }
            };
            PairsFile {
                pairs: vec![PairSpec::new(reference.clone(), query.clone(), truth)],
                ..PairsFile::default()
            }
        }
        _ => {
            return Err(Failure::usage(
                "give --reference, --query and --ground-truth, or a list of pairs with --pairs",
            ));
        }
    };
    if !quiet && file.pairs.len() > 1 {
        eprintln!("reading {} pairs", file.pairs.len());
    }
    let open = |pair: &PairSpec| Pair::open(pair, &args.members);
    let pairs: Vec<Pair> = file.pairs.par_iter().map(open).collect::<Result<_, _>>()?;
    let conditions = &file.conditions;
    let with_condition = |pair: Pair| {
        let condition = conditions.get(pair.name()).cloned();
        pair.with_condition(condition)
    };
    let pairs = pairs.into_iter().map(with_condition).collect();
    let named = file
        .subsets
        .into_iter()
        .map(|(name, list)| SubsetChoice::Named(name, list));
    Ok(Opened {
        pairs,
        named: named.collect(),
        study,
    })
}

/// What the command line says, else the study, else this.
fn words<'a, T>(given: &'a [T], study: Option<&'a Vec<T>>, default: &'a [T]) -> &'a [T] {
    let of_study = study.map(Vec::as_slice).filter(|words| !words.is_empty());
    if given.is_empty() {
        of_study.unwrap_or(default)
    } else {
        given
    }
}

fn spec(args: &EvaluateArgs, named: &[SubsetChoice], study: Option<&Study>) -> Result<Spec, Failure> {
    let kinds: Vec<SubsetKind> = match words(&args.subsets, study.map(|s| &s.subsets), &[]) {
        [] => SubsetKind::PAPER.into(),
        [none] if none == "none" => Vec::new(),
        words => words.iter().map(|w| kind(w)).collect::<Result<_, Failure>>()?,
    };
    let similarities = [String::from("l2")];
    let similarities = words(&args.similarity, study.map(|s| &s.similarities), &similarities);
    let methods = [String::from("paper")];
    let methods = words(&args.method, study.map(|s| &s.methods), &methods);
    let rules = words(&args.rule, study.map(|s| &s.rules), &[]);
    let mut subsets: Vec<SubsetChoice> = kinds.into_iter().map(SubsetChoice::Kind).collect();
    subsets.extend(named.iter().cloned());
    for text in &args.subset {
        let (name, list) = text.split_once('=').ok_or_else(|| {
            Failure::usage(format!(
                "--subset {text}: write NAME=MEMBER,MEMBER, such as fast=event_count@250ms/*"
            ))
        })?;
        let list = list.split(',').map(|m| m.trim().to_owned()).collect();
        subsets.push(SubsetChoice::Named(name.trim().to_owned(), list));
    }
    let spec = Spec {
        subsets,
        similarities: all(similarities, |w| SIMILARITIES.parse(w), "--similarity")?,
        methods: all(methods, parse_method, "--method")?,
        lengths: words(&args.length, study.map(|s| &s.lengths), &[10]).to_vec(),
        rules: all(rules, parse_rule, "--rule")?,
        exclusion: args.exclusion,
        weights: None,
        memory_bytes: args.memory << 20,
    };
    spec.check().map_err(Failure::usage)?;
    Ok(spec)
}

fn all<T>(
    words: &[String],
    parse: impl Fn(&str) -> Result<T, String>,
    option: &str,
) -> Result<Vec<T>, Failure> {
    let one = |word: &String| parse(word).map_err(|e| Failure::usage(format!("{option} {word}: {e}")));
    words.iter().map(one).collect()
}

fn kind(word: &str) -> Result<SubsetKind, Failure> {
    let found = SubsetKind::PAPER.into_iter().find(|k| k.name() == word);
    found.ok_or_else(|| {
        let names: Vec<&str> = SubsetKind::PAPER.iter().map(|k| k.name()).collect();
        Failure::usage(format!(
            "--subsets {word}: give some of {}, or none",
            names.join(", ")
        ))
    })
}

/// The bar, with the time that is left.
pub(crate) struct Bar {
    pub(crate) bar: ProgressBar,
}

impl Bar {
    pub(crate) fn new(unwanted: bool) -> Self {
        if unwanted || !std::io::stderr().is_terminal() {
            return Self {
                bar: ProgressBar::hidden(),
            };
        }
        let style =
            ProgressStyle::with_template("evaluating [{bar:40}] {percent:>3}% ({elapsed}, {eta} left)")
                .unwrap_or_else(|_| ProgressStyle::default_bar())
                .progress_chars("=> ");
        Self {
            bar: ProgressBar::new(0).with_style(style),
        }
    }
}

impl Progress for Bar {
    fn found(&self, work: u64) {
        self.bar.inc_length(work);
    }

    fn advanced(&self, work: u64) {
        self.bar.inc(work);
    }
}

/// One line per pair, kind and sequence: the best and the mean.
fn show(rows: &[Row]) {
    let width = |of: fn(&Row) -> &str, least: usize| {
        let widths = rows.iter().map(|row| of(row).chars().count());
        widths.max().unwrap_or(least).max(least)
    };
    let (pair, method) = (width(|r| &r.pair, 4), width(|r| &r.method, 8));
    let (rule, weights) = (width(|r| &r.rule, 4), width(|r| &r.weights, 7));
    say!(
        "Recall@1 of all queries; in brackets of those that have a right place\n{:<pair$}  {:<10}  {:<method$}  {:>3}  \
         {:<rule$}  {:<weights$}  {:<14}  {:>4}  {:>15}  {:>15}",
        "pair",
        "similarity",
        "method",
        "L",
        "rule",
        "weights",
        "subsets",
        "n",
        "mean",
        "best"
    );
    let (mut rest, mut lines) = (rows, 0);
    while let Some(first) = rest.first() {
        lines += 1;
        if lines > MAX_LINES {
            say!("and more, in results.csv and report.html");
            break;
        }
        let alike = |r: &Row| {
            (&r.pair, &r.similarity, &r.method, r.length, &r.rule, &r.weights)
                == (
                    &first.pair,
                    &first.similarity,
                    &first.method,
                    first.length,
                    &first.rule,
                    &first.weights,
                )
                && r.kind == first.kind
        };
        let end = rest.iter().position(|r| !alike(r)).unwrap_or(rest.len());
        let (these, others) = rest.split_at(end);
        rest = others;
        let mean = |of: &dyn Fn(&Row) -> f64| these.iter().map(of).sum::<f64>() / these.len() as f64;
        let best = these
            .iter()
            .map(|r| r.measures.recall_at[0])
            .max_by(|a, b| a.of_all.total_cmp(&b.of_all))
            .unwrap_or_default();
        say!(
            "{:<pair$}  {:<10}  {:<method$}  {:>3}  {:<rule$}  {:<weights$}  {:<14}  {:>4}  {:>7.4} ({:.3})  {:>7.4} ({:.3})",
            first.pair,
            first.similarity,
            first.method,
            first.length,
            first.rule,
            first.weights,
            first.kind.name(),
            these.len(),
            mean(&|r| r.measures.recall_at[0].of_all),
            mean(&|r| r.measures.recall_at[0].of_matchable),
            best.of_all,
            best.of_matchable
        );
    }
}
