//! What can be wrong with a map, or with the file of the last ticks.

use std::path::PathBuf;

/// Why a map, or the file of the last ticks, cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FuseError {
    /// The file of the last ticks cannot be made.
    #[error("{}: the history of the fuser cannot be kept: {problem}", path.display())]
    History {
        /// The file.
        path: PathBuf,
        /// What the system says.
        problem: String,
    },
    /// The plan names no map.
    #[error("the plan names no reference map; give one with --map")]
    NoMap,
    /// The map has no ticks at all.
    #[error(
        "the reference map is empty: it has no ticks; build it again from a recording longer than a tick"
    )]
    EmptyMap,
    /// The map has more ticks than a reference number can name.
    #[error(
        "the reference map has {references} ticks; the most is {}; split it into several maps",
        u32::MAX
    )]
    TooLong {
        /// Ticks of the map.
        references: usize,
    },
    /// The map has fewer ticks than a line through the sequence of `seqslam` needs.
    #[error(
        "the reference map has {references} ticks, fewer than the sequence of seqslam is long: none could ever be the \
         answer; write fuse.sequence.length = {references} or less"
    )]
    TooShort {
        /// Ticks of the map.
        references: usize,
        /// L.
        length: usize,
    },
    /// The plan has more members than an answer can name.
    #[error("the plan has {members} members; the most is {most}; leave some out")]
    TooManyMembers {
        /// Members of the plan.
        members: usize,
        /// Most members a plan may have.
        most: usize,
    },
    /// Map and plan differ in their number of members.
    #[error("the reference map has {map} members, the plan {plan}; build the map with this configuration")]
    Members {
        /// Members of the map.
        map: usize,
        /// Members of the plan.
        plan: usize,
    },
    /// The rows of a member have another length than the plan says.
    #[error(
        "the map rows of member {member} have {map} values, those of the plan {plan}; build the map with this configuration"
    )]
    Dimension {
        /// Name of the member.
        member: String,
        /// Values per row in the map.
        map: usize,
        /// Values per row in the plan.
        plan: usize,
    },
    /// The arrays of a member do not fit together.
    #[error(
        "member {member} of the map has {values} values and {flags} flags, expected {references} rows of {dim}; verify the map with: evpr map verify"
    )]
    Shape {
        /// Name or number of the member.
        member: String,
        /// Values there are.
        values: usize,
        /// Validity flags there are.
        flags: usize,
        /// Rows expected.
        references: usize,
        /// Values per row.
        dim: usize,
    },
    /// A member has not one row in the map.
    #[error(
        "member {member} has no row in the reference map; leave it out of the configuration or build the map again"
    )]
    NoRows {
        /// Name of the member.
        member: String,
    },
    /// A row of the map holds a value that is not finite.
    #[error("the map row of member {member} at reference {reference} is not finite; build the map again")]
    NotFinite {
        /// Name of the member.
        member: String,
        /// The map's tick.
        reference: usize,
    },
    /// A stored query row holds a value that is not finite.
    #[error("the query row of member {member} at tick {tick} is not finite; record the traverse again")]
    QueryNotFinite {
        /// Name of the member.
        member: String,
        /// Tick of the query traverse.
        tick: u64,
    },
    /// The traverse could not be opened, or it was made by other parameters than the plan's.
    #[error(transparent)]
    Store(#[from] evpr_store::StoreError),
}
