//! Which instruction sets the kernel is built for, and which of them this processor has.

/// The instruction sets by name; whoever holds one need not have it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Name {
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

/// An instruction set that this processor has: there is no other way to one than
/// [`InstructionSet::available`], so that a kernel may trust it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstructionSet(Name);

impl InstructionSet {
    /// What every processor of the architecture has.
    pub const BASELINE: Self = Self(Name::Baseline);

    /// The widest that this processor has.
    pub fn detect() -> Self {
        *Self::available().last().expect("the baseline is always there")
    }

    /// All that this processor has, narrowest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut sets = vec![Self::BASELINE];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") {
                sets.push(Self(Name::Avx2));
            }
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512bw")
            {
                sets.push(Self(Name::Avx512));
            }
        }
        sets
    }

    pub(super) fn which(self) -> Name {
        self.0
    }

    /// Name as shown to the user.
    pub fn name(self) -> &'static str {
        match self.0 {
            Name::Baseline if cfg!(target_arch = "aarch64") => "neon",
            Name::Baseline => "baseline",
            #[cfg(target_arch = "x86_64")]
            Name::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Name::Avx512 => "avx512",
        }
    }
}
