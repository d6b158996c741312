//! Cuts a scan where the range jumps, and says what stands beside each piece.

use super::beams::{Beams, Echo};
use super::verdict::{Piece, Verdict};

/// Beyond so many unknown beams nothing is said about where an object ends.
const MAX_UNKNOWN_BEAMS: usize = 3;

/// A run of beams on one surface. Beams count from `first` to `last`, on over the seam of a full turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Segment {
    pub first: usize,
    pub last: usize,
    pub hits: usize,
}

impl Segment {
    /// The segment with what became of it.
    pub fn piece(&self, beams: &Beams, verdict: Verdict) -> Piece {
        Piece { first_beam: beams.index(self.first) as u32, last_beam: beams.index(self.last) as u32, verdict }
    }
}

/// When two neighbouring echoes are of one surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// A jump up to this keeps the surface together.
    pub jump_m: f64,
    /// Added per metre of range.
    pub jump_per_range: f64,
    /// So many beams without a hit are bridged.
    pub bridge_beams: usize,
}

impl Cut {
    fn joins(&self, a: f64, b: f64) -> bool {
        (a - b).abs() <= self.jump_m + self.jump_per_range * a.min(b)
    }
}

/// Cut the scan into `segments`.
pub(super) fn split(beams: &Beams, cut: Cut, segments: &mut Vec<Segment>) {
    segments.clear();
    let n = beams.len();
    let mut open: Option<Segment> = None;
    for i in (0..n).filter(|&i| beams.echo[i] == Echo::Hit) {
        open = match open {
            Some(s) if i - s.last <= cut.bridge_beams + 1 && cut.joins(beams.range[s.last], beams.range[i]) => {
                Some(Segment { last: i, hits: s.hits + 1, ..s })
            }
            previous => {
                segments.extend(previous);
                Some(Segment { first: i, last: i, hits: 1 })
            }
        };
    }
    segments.extend(open);
    if beams.closed && segments.len() > 1 {
        join_over_seam(beams, cut, segments);
    }
}

fn join_over_seam(beams: &Beams, cut: Cut, segments: &mut Vec<Segment>) {
    let (first, last) = (segments[0], segments[segments.len() - 1]);
    let gap = first.first + beams.len() - last.last;
    if gap <= cut.bridge_beams + 1 && cut.joins(beams.range[last.last], beams.range[first.first]) {
        let joined = Segment { first: last.first, last: first.last + beams.len(), hits: first.hits + last.hits };
        segments.pop();
        segments[0] = joined;
        // Only the joined one is out of order: it starts last.
        segments.rotate_left(1);
    }
}

/// How many beams after the end of a surface at range `range` something farther begins; None where the surface may go
/// on behind a nearer object, beyond the field of view or among unknown beams.
///
/// `after(m)` is the m-th beam beyond the end, from 1.
pub(super) fn beams_to_background(beams: &Beams, range: f64, after: impl Fn(usize) -> Option<usize>) -> Option<usize> {
    for m in 1..=MAX_UNKNOWN_BEAMS + 1 {
        let i = after(m)?;
        match beams.echo[i] {
            Echo::Unknown => {}
            Echo::Near => return None,
            Echo::Beyond => return Some(m),
            Echo::Hit => return (beams.range[i] > range).then_some(m),
        }
    }
    None
}

/// The m-th beam before a segment, from 1; None beyond the field of view.
pub(super) fn before(beams: &Beams, segment: Segment, m: usize) -> Option<usize> {
    if segment.first >= m {
        Some(beams.index(segment.first - m))
    } else if beams.closed && m <= beams.len() {
        Some(segment.first + beams.len() - m)
    } else {
        None
    }
}

/// The m-th beam after a segment, from 1; None beyond the field of view.
pub(super) fn after(beams: &Beams, segment: Segment, m: usize) -> Option<usize> {
    let (i, n) = (segment.last + m, beams.len());
    if i < n {
        Some(i)
    } else if beams.closed && i - n < n {
        Some(i - n)
    } else {
        None
    }
}

/// For both ends of a segment (low index, high index), [`beams_to_background`].
pub(super) fn free_ends(beams: &Beams, segment: Segment) -> [Option<usize>; 2] {
    let (low, high) = (beams.range[beams.index(segment.first)], beams.range[beams.index(segment.last)]);
    [
        beams_to_background(beams, low, |m| before(beams, segment, m)),
        beams_to_background(beams, high, |m| after(beams, segment, m)),
    ]
}
