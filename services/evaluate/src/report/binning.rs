//! Ticks of a time against ticks of a number of events: recall over the number of frames, and how far a tick goes.

use super::Figures;
use super::chart::{Axis, Bar, Group, Series, axes, bars, short};
use super::html::{Section, Table, percent};
use super::picture::Color;
use super::view::{View, mean, recall};
use crate::pair::Pair;
use evpr_core::plan::SliceMode;

/// Pairs that are cut alike.
struct Cut {
    name: String,
    mode: SliceMode,
    /// Mean over the pairs: ticks of both traverses.
    frames: f64,
    /// Mean over the pairs of the mean over their single members.
    recall: f64,
    /// Mean and standard deviation of the way of a tick, metres.
    way: Option<(f64, f64)>,
}

pub(super) fn binning(view: &View<'_>, pairs: &[Pair], figures: &mut Figures) -> Section {
    let mut section = Section::new("binning", "Time against count");
    let (rows, what) = view.frames_alone();
    let mut cuts: Vec<Cut> = Vec::new();
    let mut names: Vec<String> = Vec::new();
    for pair in pairs {
        let name = pair.slicing.tick_id();
        if !names.contains(&name) {
            names.push(name);
        }
    }
    for name in &names {
        let these: Vec<&Pair> = pairs.iter().filter(|p| p.slicing.tick_id() == *name).collect();
        let recalls = these.iter().filter_map(|pair| {
            let of_pair = rows.iter().filter(|r| r.pair == pair.name());
            mean(&of_pair.map(|r| recall(r)).collect::<Vec<_>>())
        });
        let frames: Vec<f64> = these
            .iter()
            .map(|p| (p.queries() + p.references()) as f64)
            .collect();
        let ways: Vec<f64> = these.iter().flat_map(|p| ways(p)).collect();
        let (Some(first), Some(recall), Some(frames)) =
            (these.first(), mean(&recalls.collect::<Vec<_>>()), mean(&frames))
        else {
            continue;
        };
        cuts.push(Cut {
            name: name.clone(),
            mode: first.slicing.mode,
            frames,
            recall,
            way: spread(&ways),
        });
    }
    if cuts.is_empty() {
        section.lacks(
            "No single members of the pairs at hand were evaluated; give --subsets single, or leave it out.",
        );
        return section;
    }
    let mut table = Table::new(&[
        "ticks of",
        "frames",
        "AR@1",
        "way of a tick",
        "spread",
        "spread / way",
    ]);
    for cut in &cuts {
        let way =
            |text: &dyn Fn(f64, f64) -> String| cut.way.map_or_else(|| "–".to_owned(), |(m, s)| text(m, s));
        table.row(vec![
            cut.name.clone(),
            format!("{:.0}", cut.frames),
            percent(cut.recall),
            way(&|m, _| format!("{m:.2} m")),
            way(&|_, s| format!("{s:.2} m")),
            way(&|m, s| {
                if m > 0.0 {
                    format!("{:.2}", s / m)
                } else {
                    "–".to_owned()
                }
            }),
        ]);
    }
    let caption = format!(
        "Frames: ticks of reference and query together, mean over pairs. AR@1: of {what}. Way: from the start of one tick to \
         that of the next, with its standard deviation."
    );
    section.add(&table.caption(&caption).html());
    let mut pictures = vec![recall_over_frames(&cuts)];
    if cuts.iter().any(|c| c.way.is_some()) {
        pictures.push(way_of_ticks(&cuts));
    } else {
        section.lacks(
            "How far a tick goes is not known: the traverses have no positions. Record them with [positions] in the \
             configuration, or give maps --positions.",
        );
    }
    section.pictures(&pictures);
    figures.extend(pictures);
    let has = |mode: SliceMode| cuts.iter().any(|c| c.mode == mode);
    if !(has(SliceMode::Time) && has(SliceMode::Count)) {
        section.lacks(
            "To compare time with count, record the same drives with [slicing] mode = \"time\" and with mode = \"count\", \
             each with several ticks, and list all of these pairs (--pairs).",
        );
    }
    section
}

/// Metres from each tick's start to the next one's.
fn ways(pair: &Pair) -> Vec<f64> {
    let of = |positions: &[Option<[f64; 2]>]| -> Vec<f64> {
        let steps = positions.windows(2).filter_map(|w| {
            let (a, b) = (w[0]?, w[1]?);
            Some((a[0] - b[0]).hypot(a[1] - b[1]))
        });
        steps.collect()
    };
    [of(&pair.reference_positions), of(&pair.query_positions)].concat()
}

/// Mean and standard deviation (of all, not of a sample).
fn spread(values: &[f64]) -> Option<(f64, f64)> {
    let middle = mean(values)?;
    let squares: Vec<f64> = values.iter().map(|v| (v - middle).powi(2)).collect();
    Some((middle, mean(&squares)?.sqrt()))
}

fn recall_over_frames(cuts: &[Cut]) -> super::Picture {
    let series = [
        (SliceMode::Time, "ticks of a time"),
        (SliceMode::Count, "ticks of a number of events"),
    ];
    let series: Vec<Series> = series
        .into_iter()
        .enumerate()
        .map(|(at, (mode, name))| {
            let mut of_mode: Vec<&Cut> = cuts.iter().filter(|c| c.mode == mode).collect();
            of_mode.sort_by(|a, b| a.frames.total_cmp(&b.frames));
            Series {
                name: name.to_owned(),
                color: Color::Series(at),
                points: of_mode
                    .iter()
                    .map(|c| (c.frames, c.recall, format!("{}: {:.4}", c.name, c.recall)))
                    .collect(),
                joined: true,
            }
        })
        .filter(|s| !s.points.is_empty())
        .collect();
    axes(
        "recall_over_frames",
        "Recall over the number of frames, which is what it costs.",
        Axis::log("frames of reference and query", cuts.iter().map(|c| c.frames)),
        Axis::share("AR@1 of all queries"),
        &series,
    )
}

fn way_of_ticks(cuts: &[Cut]) -> super::Picture {
    let most = cuts.iter().filter_map(|c| c.way).map(|(m, s)| m + s);
    let most = most.fold(1.0, f64::max) * 1.05;
    let groups: Vec<Group> = cuts
        .iter()
        .filter_map(|c| {
            let (way, spread) = c.way?;
            Some(Group {
                name: format!("ticks of {}", c.name),
                bars: vec![Bar {
                    series: usize::from(c.mode == SliceMode::Count),
                    value: way,
                    range: Some(((way - spread).max(0.0), way + spread)),
                    title: format!("{} ± {} m", short(way), short(spread)),
                }],
            })
        })
        .collect();
    let both = cuts.iter().any(|c| c.mode == SliceMode::Count);
    let series = if both { &["time", "count"][..] } else { &["time"] };
    let series: Vec<String> = series.iter().map(|s| (*s).to_owned()).collect();
    bars(
        "way_of_ticks",
        "Way of a tick: mean with its standard deviation. The less it spreads, the more alike are two drives cut.",
        "metres",
        most,
        &series,
        &groups,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ways_have_a_mean_and_a_spread() {
        assert_eq!(spread(&[]), None);
        assert_eq!(spread(&[2.0, 4.0]), Some((3.0, 1.0)));
    }
}
