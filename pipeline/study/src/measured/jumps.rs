//! Where a command jumps between its samples.

/// A change of the command is a jump where it is so many times its neighbours' (assumed).
const JUMP: f64 = 8.0;
/// Where a jump is between its samples as long as nothing says it.
pub const USUAL: f64 = 0.5;

/// Jumps of a command.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Jumps(
    /// sample before, and the share of the time to the next one after which it jumps
    pub Vec<(usize, f64)>,
);

impl Jumps {
    /// Those of a command, somewhere between their samples.
    pub fn of(command: &[f64]) -> Self {
        let change = |k: usize| command[k + 1] - command[k];
        let n = command.len();
        let is_jump = |k: &usize| {
            let before = if *k > 0 { change(k - 1).abs() } else { f64::INFINITY };
            let after = if k + 2 < n { change(k + 1).abs() } else { f64::INFINITY };
            change(*k).abs() > JUMP * before.max(after) && change(*k) != 0.0
        };
        let at = (0..n.saturating_sub(1)).filter(is_jump);
        Self(at.map(|k| (k, USUAL)).collect())
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The same jumps, all at one share of their samples.
    pub fn all_at(&self, share: f64) -> Self {
        Self(self.0.iter().map(|j| (j.0, share)).collect())
    }

    /// Each at its own.
    pub fn set(&mut self, shares: &[f64]) {
        self.0.iter_mut().zip(shares).for_each(|(j, s)| j.1 = *s);
    }

    /// Share after which the command jumps after sample `k`, where it does.
    pub fn after(&self, k: usize) -> Option<f64> {
        let at = self.0.binary_search_by_key(&k, |j| j.0).ok()?;
        Some(self.0[at].1)
    }
}
