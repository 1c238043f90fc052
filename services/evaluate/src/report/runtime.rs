//! What an ensemble takes per tick, and what it recognises for that.

use super::Figures;
use super::chart::{Axis, Series, axes};
use super::html::{Section, Table, percent};
use super::picture::Color;
use super::view::{View, kind_title, mean, mean_recall, recall};
use crate::choose::Costs;
use crate::error::EvaluateError;
use crate::pair::Pair;
use crate::results::Row;
use crate::spec::Spec;
use std::collections::BTreeMap;

/// Checks that the costs know every stage of these pairs' members.
///
/// # Errors
/// One line that names the stage.
pub fn check_costs(pairs: &[Pair], costs: &Costs) -> Result<(), EvaluateError> {
    pairs
        .iter()
        .try_for_each(|pair| costs.of(pair.members()).map(|_| ()))
}

/// What a subset takes per tick, ms, by its kind and name.
type Prices = BTreeMap<(crate::SubsetKind, String), f64>;

fn prices(pairs: &[Pair], spec: &Spec, costs: &Costs) -> Result<Prices, EvaluateError> {
    let mut all = Prices::new();
    for pair in pairs {
        let prices = costs.of(pair.members())?;
        for c in spec.configurations(pair.members())? {
            let members: Vec<usize> = c.subset.members.iter().collect();
            all.insert((c.subset.kind, c.subset.name.clone()), prices.cost(&members));
        }
    }
    Ok(all)
}

/// # Errors
/// The costs do not know a stage.
pub(super) fn runtime(
    view: &View<'_>,
    pairs: &[Pair],
    spec: &Spec,
    costs: Option<&Costs>,
    figures: &mut Figures,
) -> Result<Section, EvaluateError> {
    let mut section = Section::new("runtime", "Runtime against recall");
    let Some(costs) = costs else {
        section.lacks(
            "What the stages take is not known; give --costs with the statistics of a run (evpr run --stats FILE), the \
             results of evpr demo, or a TOML file of times.",
        );
        return Ok(section);
    };
    let prices = prices(pairs, spec, costs)?;
    let price = |r: &Row| prices.get(&(r.kind, r.subset.clone())).copied();
    let mut table = Table::new(&["ensemble", "ms per tick", "from", "to", "AR@1", "best"]);
    let mut series = Vec::new();
    for (at, kind) in view.kinds().into_iter().enumerate() {
        let rows: Vec<&Row> = view
            .main_rows()
            .filter(|r| r.kind == kind && price(r).is_some())
            .collect();
        let ms: Vec<f64> = rows.iter().filter_map(|r| price(r)).collect();
        let (Some(middle), Some(ar)) = (mean(&ms), mean_recall(rows.iter().copied())) else {
            continue;
        };
        let best = rows.iter().map(|r| recall(r)).fold(0.0, f64::max);
        table.row(vec![
            kind_title(kind).to_owned(),
            format!("{middle:.2}"),
            format!("{:.2}", ms.iter().copied().fold(f64::INFINITY, f64::min)),
            format!("{:.2}", ms.iter().copied().fold(0.0, f64::max)),
            percent(ar),
            percent(best),
        ]);
        let mut by_name: BTreeMap<&str, Vec<&Row>> = BTreeMap::new();
        for row in rows {
            by_name.entry(&row.subset).or_default().push(row);
        }
        let points = by_name.into_iter().filter_map(|(name, rows)| {
            let (ms, ar) = (price(rows.first()?)?, mean_recall(rows.into_iter())?);
            Some((ms, ar, format!("{name}: {ms:.2} ms, {ar:.4}")))
        });
        series.push(Series {
            name: kind_title(kind).to_owned(),
            color: Color::Series(at),
            points: points.collect(),
            joined: false,
        });
    }
    let all = series.iter().flat_map(|s| &s.points).map(|p| p.0);
    if all.clone().next().is_none() {
        section.lacks("No ensemble of this evaluation has a time.");
        return Ok(section);
    }
    let caption = "Time of the stages per tick, one after the other; what is shared counts once. AR@1 is the mean over pairs \
                   and lengths.";
    section.add(&table.caption(caption).html());
    let picture = axes(
        "runtime_against_recall",
        "Each ensemble: its time per tick and its AR@1. Up and to the left is better.",
        Axis::log("ms per tick", all),
        Axis::share("AR@1 of all queries"),
        &series,
    );
    section.pictures(std::slice::from_ref(&picture));
    figures.push(picture);
    Ok(section)
}
