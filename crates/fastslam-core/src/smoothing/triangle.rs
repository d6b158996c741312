//! The upper triangle of a sparse symmetric matrix.

/// The upper triangle of a symmetric matrix, column by column.
#[derive(Clone, Debug, Default)]
pub struct UpperTriangle {
    /// Where each column starts; one more than columns.
    pub column_starts: Vec<usize>,
    /// Row of each value, ascending within a column; the last of a column is its diagonal.
    pub rows: Vec<usize>,
    /// Values.
    pub values: Vec<f64>,
}

impl UpperTriangle {
    /// The places of all numbers for a chain of poses of `P` variables, and landmarks of `D` after them: a pose's column
    /// holds the pose before and its own triangle, a landmark's column the first `S` variables of the poses that saw it, in
    /// their order, and its own triangle.
    pub fn of_chain<const P: usize, const S: usize, const D: usize>(
        poses: usize,
        seen_from: impl Iterator<Item = impl Iterator<Item = usize> + Clone>,
    ) -> Self {
        let mut upper = Self { column_starts: vec![0], ..Self::default() };
        for pose in 0..poses {
            for c in 0..P {
                let before = P * pose.saturating_sub(1);
                upper.rows.extend(before..P * pose + c + 1);
                upper.column_starts.push(upper.rows.len());
            }
        }
        for (landmark, seen_from) in seen_from.enumerate() {
            let own = P * poses + D * landmark;
            for c in 0..D {
                upper.rows.extend(seen_from.clone().flat_map(|pose| P * pose..P * pose + S));
                upper.rows.extend(own..own + c + 1);
                upper.column_starts.push(upper.rows.len());
            }
        }
        upper.values = vec![0.0; upper.rows.len()];
        upper
    }

    pub(super) fn size(&self) -> usize {
        self.column_starts.len() - 1
    }

    /// Multiplies the diagonal by a number.
    pub fn scale_diagonal(&mut self, factor: f64) {
        for end in &self.column_starts[1..] {
            self.values[end - 1] *= factor;
        }
    }
}
