//! `evpr evaluate`: recall of recorded traverses, over subsets, methods, lengths and rules at once.

use crate::args::EvaluateArgs;
use crate::failure::Failure;
use crate::output::say;
use evpr_core::config::{SIMILARITIES, parse_method, parse_rule};
use evpr_evaluate::statistics::{comparisons, members};
use evpr_evaluate::{
    LearntWeights, Pair, PairSpec, PairsFile, Progress, Results, Row, Spec, SubsetChoice, SubsetKind, Truth,
    evaluate as run, learnt_weights, read_weights,
};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use std::io::IsTerminal;
use std::path::Path;
use std::process::ExitCode;

/// Most lines of the table.
const MAX_LINES: usize = 60;

/// `evpr evaluate`.
pub(crate) fn evaluate(args: &EvaluateArgs) -> Result<ExitCode, Failure> {
    let (pairs, named) = open_pairs(&args.pairs, args.quiet)?;
    let spec = spec(args, &named)?;
    let inputs: Vec<&Path> = args.pairs.folders();
    crate::output::refuse_input(&args.out, &inputs)?;
    let teacher = args
        .learn_weights
        .as_deref()
        .map(|name| pair_named(&pairs, name))
        .transpose()?;
    let given = args.weights.as_deref();
    let given = given.map(|path| read_weights(path, &pairs)).transpose()?;
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
    results.write_report(&compared)?;
    if let Some(wanted) = args.wanted_precision {
        results.write_thresholds(wanted)?;
    }
    if args.likeness {
        let alike: Result<Vec<_>, _> = pairs.iter().map(|pair| members(pair, &spec)).collect();
        results.write_members(&alike?)?;
    }
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

/// Opens all pairs that were asked for, and gives subsets that have a name.
pub(crate) fn open_pairs(
    args: &crate::args::PairArgs,
    quiet: bool,
) -> Result<(Vec<Pair>, Vec<SubsetChoice>), Failure> {
    let file = match (&args.pairs, &args.reference, &args.query, &args.ground_truth) {
        (Some(path), ..) => PairsFile::read(path)?,
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
    let named = file
        .subsets
        .into_iter()
        .map(|(name, list)| SubsetChoice::Named(name, list));
    Ok((pairs, named.collect()))
}

fn spec(args: &EvaluateArgs, named: &[SubsetChoice]) -> Result<Spec, Failure> {
    let kinds: Vec<SubsetKind> = match args.subsets.as_slice() {
        [] => SubsetKind::PAPER.into(),
        [none] if none == "none" => Vec::new(),
        words => words.iter().map(|w| kind(w)).collect::<Result<_, Failure>>()?,
    };
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
        similarities: all(&args.similarity, |w| SIMILARITIES.parse(w), "--similarity")?,
        methods: all(&args.method, parse_method, "--method")?,
        lengths: args.length.clone(),
        rules: all(&args.rule, parse_rule, "--rule")?,
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
