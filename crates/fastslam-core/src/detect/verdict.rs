//! What became of each piece of a scan, so that a user can see why an object was missed.

/// Why a piece of a scan is a landmark, or why not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Verdict {
    /// A landmark.
    Detected,
    /// Fewer beams than `min_beams`.
    TooFewBeams,
    /// Beyond the detector's `max_range_m`.
    TooFar,
    /// Wider than the largest object.
    TooWide,
    /// Smaller than the smallest object.
    TooSmall,
    /// Both ends lie behind nearer surfaces, at the border of the view, or too close before the background.
    EndsHidden,
    /// Its points do not lie on one circle (trunks) or one line (corners).
    PoorFit,
    /// The centre would be less certain than `max_center_std_m`.
    Uncertain,
    /// In line with what is seen beside it: a wall at grazing incidence.
    Wall,
    /// A straight wall that meets no other in a corner.
    NoCorner,
}

impl Verdict {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 10] = [
        Self::Detected,
        Self::TooFewBeams,
        Self::TooFar,
        Self::TooWide,
        Self::TooSmall,
        Self::EndsHidden,
        Self::PoorFit,
        Self::Uncertain,
        Self::Wall,
        Self::NoCorner,
    ];

    /// In words, for figures.
    pub fn label(self) -> &'static str {
        match self {
            Self::Detected => "detected",
            Self::TooFewBeams => "too few beams",
            Self::TooFar => "too far",
            Self::TooWide => "too wide",
            Self::TooSmall => "too small",
            Self::EndsHidden => "both ends hidden",
            Self::PoorFit => "poor fit",
            Self::Uncertain => "centre uncertain",
            Self::Wall => "part of a wall",
            Self::NoCorner => "no corner",
        }
    }
}

/// A run of beams on one surface and what became of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// First beam of the piece.
    pub first_beam: u32,
    /// Last beam of the piece (below `first_beam` where a full turn's seam lies within).
    pub last_beam: u32,
    /// Why it is a landmark, or why not.
    pub verdict: Verdict,
}
