//! `evpr choose`: the members that recognise most for a given time per tick.

use super::evaluate::{Bar, Opened, open_pairs};
use crate::args::ChooseArgs;
use crate::catalog;
use crate::failure::Failure;
use crate::output::say;
use evpr_core::config::{SIMILARITIES, parse_method, parse_rule};
use evpr_core::plan::{Rule, SequenceMethod};
use evpr_evaluate::MemberName;
use evpr_evaluate::choose::{Choice, Chosen, Costs, Wanted, choose as search};
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

/// `evpr choose`.
pub(crate) fn choose(args: &ChooseArgs) -> Result<ExitCode, Failure> {
    if args.out.is_some() != args.config.is_some() {
        return Err(Failure::usage(
            "--out writes the configuration of --config with the members that are chosen; give both or neither",
        ));
    }
    if let Some(out) = args.out.as_ref().filter(|out| out.exists()) {
        return Err(Failure::new(format!(
            "{} exists already; choose another name or remove it",
            out.display()
        )));
    }
    let asked = |option: &'static str| move |e: String| Failure::usage(format!("{option}: {e}"));
    let method = parse_method(&args.method).map_err(asked("--method"))?;
    let rule = match &args.rule {
        Some(rule) => parse_rule(rule).map_err(asked("--rule"))?,
        None => Rule::default_with(Some(method)),
    };
    let wanted = Wanted {
        budget_ms: args.budget as f64 / 1e6,
        similarity: SIMILARITIES
            .parse(&args.similarity)
            .map_err(asked("--similarity"))?,
        method,
        length: if method.has_length() { args.length } else { 1 },
        rule,
        exact_up_to: args.exact,
        memory_bytes: args.memory << 20,
    };
    let costs = Costs::read(&args.costs)?;
    let Opened { pairs, .. } = open_pairs(&args.pairs, args.quiet)?;
    let bar = Bar::new(args.quiet);
    let chosen = search(&pairs, &wanted, &costs, &bar);
    bar.bar.finish_and_clear();
    let chosen = chosen?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&chosen)?);
    } else {
        show(&chosen);
    }
    if let (Some(config), Some(out)) = (&args.config, &args.out) {
        write_config(&wanted, config, out, &chosen.choice)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn show(chosen: &Chosen) {
    say!(
        "{:>10}  {:>8}  {:>15}  members",
        "ms",
        "fitted",
        "cross-validated"
    );
    let line = |choice: &Choice, cross: Option<f64>, what: &str| {
        let cross = cross.map_or_else(|| "-".to_owned(), |c| format!("{c:.4}"));
        say!(
            "{:>10.3}  {:>8.4}  {cross:>15}  {what} ({})",
            choice.cost_ms,
            choice.recall,
            choice.members.len()
        );
    };
    line(&chosen.choice, Some(chosen.cross_validated), "chosen");
    if let Some(exact) = &chosen.exact {
        line(exact, chosen.exact_cross_validated, "best of all sets");
    }
    line(&chosen.all, None, "all members");
    say!("\nchosen for {} ms, member by member", chosen.budget_ms);
    for step in &chosen.steps {
        say!("{:>10.3}  {:>8.4}  {}", step.cost_ms, step.recall, step.member);
    }
    say!("\nleft out in turn: what the rest chose, and how it does there");
    for fold in &chosen.folds {
        say!(
            "{:>10.3}  {:>8.4}  {:>15.4}  {}: {}",
            fold.choice.cost_ms,
            fold.choice.recall,
            fold.recall,
            fold.left_out,
            fold.choice.members.join(", ")
        );
    }
    say!(
        "\nPareto front of the {} sets that were tried (fitted)",
        chosen.tried
    );
    for choice in &chosen.front {
        say!(
            "{:>10.3}  {:>8.4}  {}",
            choice.cost_ms,
            choice.recall,
            choice.members.join(", ")
        );
    }
}

/// Writes the configuration with these members, and with no stage or window that none of them uses.
fn write_config(wanted: &Wanted, config: &Path, out: &Path, choice: &Choice) -> Result<(), Failure> {
    let wrong = |reason: String| Failure::new(format!("{}: {reason}", config.display()));
    let given = catalog::load(config)?;
    let known = |member: &&String| given.members().iter().any(|m| m.name == **member);
    if let Some(missing) = choice.members.iter().find(|m| !known(m)) {
        return Err(wrong(format!(
            "it has no member {missing}; give the configuration that the traverses were recorded with"
        )));
    }
    let text = std::fs::read_to_string(config).map_err(|e| wrong(e.to_string()))?;
    let mut table: toml::Table = text.parse().map_err(|e: toml::de::Error| wrong(e.to_string()))?;
    let parts: Vec<MemberName<'_>> = choice
        .members
        .iter()
        .filter_map(|m| MemberName::parse(m))
        .collect();
    for (key, used) in [
        (
            "reconstruction",
            parts.iter().map(|p| p.reconstruction).collect::<Vec<_>>(),
        ),
        ("extractor", parts.iter().map(|p| p.extractor).collect()),
    ] {
        if let Some(toml::Value::Array(stages)) = table.get_mut(key) {
            let id = |stage: &toml::Value| stage.get("id").and_then(|id| id.as_str().map(str::to_owned));
            stages.retain(|stage| id(stage).is_some_and(|id| used.contains(&id.as_str())));
        }
    }
    if let Some(toml::Value::Table(slicing)) = table.get_mut("slicing")
        && let Some(toml::Value::Array(windows)) = slicing.get_mut("windows")
    {
        let used: Vec<&str> = parts.iter().map(|p| p.window).collect();
        windows.retain(|w| match w {
            toml::Value::String(text) => used.iter().any(|u| same_window(u, text)),
            _ => true,
        });
    }
    let members = choice.members.iter().cloned().map(toml::Value::String).collect();
    let mut ensemble = toml::Table::new();
    ensemble.insert("members".to_owned(), toml::Value::Array(members));
    table.insert("ensemble".to_owned(), ensemble.into());
    let fuse = table
        .entry("fuse")
        .or_insert_with(|| toml::Table::new().into())
        .as_table_mut()
        .ok_or_else(|| wrong("fuse is no table".to_owned()))?;
    let sequence = sequence(wanted);
    let similarities = SIMILARITIES.all();
    let similarity = similarities
        .into_iter()
        .find(|w| SIMILARITIES.parse(w) == Ok(wanted.similarity));
    fuse.insert("similarity".to_owned(), similarity.unwrap_or("l2").into());
    fuse.insert("sequence".to_owned(), sequence.into());
    fuse.insert("rule".to_owned(), wanted.rule.name().into());
    fuse.remove("trim");
    if let Rule::TrimmedMean { trim } = wanted.rule {
        fuse.insert("trim".to_owned(), trim.into());
    }
    let text = toml::to_string(&table).map_err(|e| wrong(e.to_string()))?;
    // What is written must be what `evpr run` takes.
    let file = out.display().to_string();
    catalog::parse(&text, &file)?;
    let head = format!(
        "# {} with the members that `evpr choose` found for {} ms per tick: fitted recall {:.4}.\n",
        config.display(),
        wanted.budget_ms,
        choice.recall
    );
    let created = std::fs::OpenOptions::new().write(true).create_new(true).open(out);
    created
        .and_then(|mut file| file.write_all((head + &text).as_bytes()))
        .map_err(|e| Failure::new(format!("{file}: cannot be written: {e}")))
}

/// The sequence method with all its parameters, as in a configuration.
fn sequence(wanted: &Wanted) -> toml::Table {
    let mut table = toml::Table::new();
    let mut set = |key: &str, value: toml::Value| table.insert(key.to_owned(), value);
    set("method", wanted.method.name().into());
    if wanted.method.has_length() {
        set("length", (wanted.length as i64).into());
    }
    match wanted.method {
        SequenceMethod::SeqSlam(is) => {
            set("window", (is.window as i64).into());
            set("velocities", is.velocities.to_vec().into());
            set("velocity_steps", (is.velocity_steps as i64).into());
        }
        SequenceMethod::Filter(is) => {
            set("beta", is.beta.into());
            set("transition", is.transition.probabilities().to_vec().into());
            set("restart", is.restart.into());
        }
        SequenceMethod::Paper | SequenceMethod::Rows | SequenceMethod::None => {}
    }
    table
}

/// Whether a window's id and a duration of the configuration mean the same.
fn same_window(id: &str, text: &str) -> bool {
    use evpr_core::time::parse_duration_ns;
    id == text || matches!((parse_duration_ns(id), parse_duration_ns(text)), (Ok(a), Ok(b)) if a == b)
}
