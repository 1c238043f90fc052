//! The page of the report: one file, with the pictures beside it, that asks nobody for anything.

use super::frames::Place;
use super::pictures::pass_title;
use super::recall::{EnsembleRecall, KindRecall, kind_title};
use super::results::Results;
use evpr_core::plan::StreetPass;
use evpr_evaluate::SubsetKind;
use std::fmt::Write;

/// The page, with `{{name}}` where something goes.
const TEMPLATE: &str = include_str!("../../assets/demo_report.html");

/// Writes the page.
pub(crate) fn write(results: &Results, place: &Place) -> String {
    let (scene, latency) = (&results.scene, &results.latency);
    let combined = |pass| {
        let recall = results.recall_of(SubsetKind::Combined, pass, scene.sequence_length);
        format!("{:.2}", recall.map_or(0.0, |r| r.mean))
    };
    let median = latency.stages.last().map_or(0.0, |s| s.median_us / 1e3);
    let tables: String = results
        .lengths()
        .into_iter()
        .map(|length| recall_table(results, length))
        .collect();
    fill(&[
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("seed", scene.seed.to_string()),
        ("took", format!("{:.0}", results.took_s)),
        ("cores", latency.cores.to_string()),
        ("street_m", scene.length_m.to_string()),
        ("tick", scene.tick.clone()),
        ("members", scene.members.to_string()),
        ("reconstructions", scene.reconstructions.len().to_string()),
        ("windows", scene.windows.len().to_string()),
        ("extractors", scene.extractors.len().to_string()),
        ("combined_day", combined(StreetPass::Day2)),
        ("combined_night", combined(StreetPass::Night)),
        ("median_ms", format!("{median:.1}")),
        (
            "shared_mib",
            format!("{:.0}", scene.shared_memory_bytes as f64 / f64::from(1 << 20)),
        ),
        ("recall_tables", tables),
        ("tolerance_m", scene.tolerance_m.to_string()),
        ("equal", equal_answers(results)),
        ("frames_text", frames_text(place)),
        ("latency_tables", latency_tables(results)),
        ("latency_ticks", (latency.ticks + latency.left_out).to_string()),
        (
            "load",
            latency
                .load_1min
                .map_or_else(String::new, |l| format!(", load of the machine {l:.1}")),
        ),
        ("left_out", left_out(latency.left_out)),
        ("passes", passes(results)),
    ])
}

fn fill(values: &[(&str, String)]) -> String {
    values.iter().fold(TEMPLATE.to_owned(), |page, (name, value)| {
        page.replace(&format!("{{{{{name}}}}}"), value)
    })
}

/// Text that may stand in HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

fn recall_table(results: &Results, length: usize) -> String {
    let share = |recall: Option<&EnsembleRecall>| {
        recall.map_or_else(
            || "<td></td>".to_owned(),
            |e| format!("<td title=\"{}\">{:.3}</td>", escaped(&e.name), e.recall_at_1),
        )
    };
    let mean = |recall: Option<&KindRecall>| format!("<td>{:.3}</td>", recall.map_or(0.0, |r| r.mean));
    let mut rows = String::new();
    for kind in SubsetKind::PAPER {
        let (day, night) = (
            results.recall_of(kind, StreetPass::Day2, length),
            results.recall_of(kind, StreetPass::Night, length),
        );
        let count = day.map_or(0, |r| r.ensembles.len());
        // Writing into a string cannot fail.
        let _ = writeln!(
            rows,
            "<tr><td>{} <span class=\"best\">({count})</span></td>{}{}{}{}{}</tr>",
            kind_title(kind),
            share(day.and_then(KindRecall::best)),
            mean(day),
            share(night.and_then(KindRecall::best)),
            mean(night),
            share(results.chosen_by_day(kind, length)),
        );
    }
    let caption = match length {
        1 => "Each tick alone (L = 1).".to_owned(),
        n => format!(
            "Sequences of {n} ticks (L = {n}), as the graph ran. In brackets: how many ensembles of the kind there are."
        ),
    };
    format!(
        "<div class=\"scroll\"><table>\n<thead><tr><th>ensembles</th><th>day, best</th><th>mean</th><th>night, best</th>\
         <th>mean</th><th>day's best</th></tr></thead>\n<tbody>\n{rows}</tbody>\n<caption>{caption}</caption>\n</table></div>\n"
    )
}

/// Whether the running graph and the evaluation agree.
fn equal_answers(results: &Results) -> String {
    let known = results
        .passes
        .iter()
        .filter_map(|p| Some((p.equal_answers?, p.ticks)));
    let (equal, ticks) = known.fold((0, 0), |(a, b), (equal, ticks)| (a + equal, b + ticks));
    format!(
        "For all members together they repeat the answers that the running graph gave at {equal} of {ticks} ticks."
    )
}

fn frames_text(place: &Place) -> String {
    let seen = place
        .seen
        .iter()
        .map(|seen| format!("{} at {:.1} m", pass_title(seen.pass), seen.along_m));
    let seen: Vec<String> = seen.collect();
    format!(
        "Frames of a window of {} at one place: {}.",
        escaped(&place.window),
        seen.join(", ")
    )
}

fn latency_tables(results: &Results) -> String {
    let mut stages = String::new();
    for stage in &results.latency.stages {
        let (median, slowest) = (stage.median_us / 1e3, stage.slowest_us / 1e3);
        let _ = writeln!(
            stages,
            "<tr><td>{}</td><td>{median:.3}</td><td>{slowest:.3}</td></tr>",
            stage.stage
        );
    }
    let mut processes = String::new();
    for process in &results.latency.processes {
        let (p50, p99) = (process.p50_us / 1e3, process.p99_us / 1e3);
        let _ = writeln!(
            processes,
            "<tr><td>{}</td><td>{}</td><td>{p50:.3}</td><td>{p99:.3}</td></tr>",
            escaped(&process.process),
            process.messages
        );
    }
    format!(
        "<div class=\"scroll\"><table>\n<thead><tr><th>stage</th><th>median, ms</th><th>slowest, ms</th></tr></thead>\n\
         <tbody>\n{stages}</tbody>\n<caption>From the end of a tick's last window to its last frame, from there to its \
         last row, from there to its answer, and all of it.</caption>\n</table></div>\n\
         <div class=\"scroll\"><table>\n<thead><tr><th>process</th><th>messages</th><th>median, ms</th><th>99 %, ms</th></tr>\
         </thead>\n<tbody>\n{processes}</tbody>\n<caption>Work of each process per message, over the same run.</caption>\n\
         </table></div>\n"
    )
}

fn left_out(ticks: usize) -> String {
    match ticks {
        0 => String::new(),
        n => format!("The latency of {n} of them is not known, and they are left out."),
    }
}

fn passes(results: &Results) -> String {
    let row = |pass: &super::results::PassResult| {
        format!(
            "<tr><td>{}</td><td>{}</td><td>{:.1} M</td><td>{:.1} s</td></tr>\n",
            pass_title(pass.pass),
            pass.ticks,
            pass.events as f64 / 1e6,
            pass.took_s
        )
    };
    results.passes.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_asks_nobody_for_anything() {
        for outside in ["http:", "https:", "//", "<script", "@import", "url("] {
            assert!(!TEMPLATE.contains(outside), "{outside}");
        }
    }

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(escaped("<b>&"), "&lt;b&gt;&amp;");
    }
}
