//! `[governor]`: the latency that members are shed to keep.

use super::reader::Table;
use super::schema::key;
use super::words::not_one_of;
use crate::plan::{Governor, Member};

/// Answers within the budget after which a member is tried again.
const DEFAULT_HOLD: i64 = 20;

/// `[governor]`; none without a budget. `members` are those of the ensemble, as far as they are known.
pub(super) fn governor(table: Table<'_>, members: Option<&[Member]>) -> Option<Option<Governor>> {
    let budget_ns = table.read_optional(
        key(
            "budget",
            "duration",
            None,
            "Members are shed where the 95th percentile of window-close to answer is above this, and taken back when \
             there is room. Without it nobody is shed.",
        ),
        |v| match v.duration_ns()? {
            0 => v.refuse("is no time at all; write how long an answer may take, such as \"200ms\""),
            ns => Some(ns),
        },
    );
    let without = matches!(budget_ns, Some(None));
    let order = table.read_optional(
        key(
            "order",
            "list of members",
            None,
            "Members in the order in which they are shed; others never are. When not given: all, the dearest for its \
             weight first.",
        ),
        |v| {
            if without {
                return v.refuse("has no effect without budget; write one, or remove it");
            }
            // Where the members are not known, what is wrong with them is said already.
            let members = members?;
            let order = v.list("a list of members", |v| {
                let name = v.text("a member's name")?;
                let index = members.iter().position(|m| m.name == name);
                index.or_else(|| {
                    let known: Vec<&str> = members.iter().map(|m| m.name.as_str()).collect();
                    v.refuse(format!("no such member: {}", not_one_of(name, &known)))
                })
            })?;
            let order: Vec<usize> = order.into_iter().collect::<Option<_>>()?;
            if (1..order.len()).any(|i| order[..i].contains(&order[i])) {
                return v.refuse("names a member twice; write it once");
            }
            if order.is_empty() {
                return v.refuse("is empty, so nobody could be shed; name members, or remove the key");
            }
            Some(order)
        },
    );
    let hold = table.read(
        key(
            "hold",
            "whole number from 1 to 100000",
            Some("20"),
            "Answers within the budget after which a member is tried again; doubled each time that fails.",
        ),
        DEFAULT_HOLD,
        |v| {
            if without {
                return v.refuse("has no effect without budget; write one, or remove it");
            }
            v.integer(1..=100_000)
        },
    );
    table.close();
    let (budget_ns, order, hold) = (budget_ns?, order?, hold?);
    Some(budget_ns.map(|budget_ns| Governor {
        budget_ns,
        order: order.unwrap_or_default(),
        hold: hold as u32,
    }))
}
