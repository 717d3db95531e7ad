//! Telemetry channels, written down once: name, unit, meaning, sampling, order.

/// How a sample stands for its interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sampling {
    /// value after the last step of the interval
    End,
    /// mean over the interval
    Mean,
}

macro_rules! channels {
    ($($variant:ident $name:literal $unit:literal $sampling:ident $basic:literal $meaning:literal),+ $(,)?) => {
        /// A telemetry channel.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(usize)]
        pub enum Channel { $(#[doc = concat!($meaning, " [", $unit, "], column `", $name, "`")] $variant),+ }

        impl Channel {
            /// All channels, in the order of columns.
            pub const ALL: &'static [Channel] = &[$(Channel::$variant),+];
            /// Number of channels.
            pub const COUNT: usize = Self::ALL.len();
            /// Column name in files.
            pub fn name(self) -> &'static str { match self { $(Channel::$variant => $name),+ } }
            /// SI unit.
            pub fn unit(self) -> &'static str { match self { $(Channel::$variant => $unit),+ } }
            /// How a sample stands for its interval.
            pub fn sampling(self) -> Sampling { match self { $(Channel::$variant => Sampling::$sampling),+ } }
            /// Recorded unless asked otherwise.
            pub fn is_basic(self) -> bool { match self { $(Channel::$variant => $basic),+ } }
            /// What it is, in words; as in the table of `README.md`.
            pub fn meaning(self) -> &'static str { match self { $(Channel::$variant => $meaning),+ } }
            /// The channel of a column; none for a name that the table does not have.
            pub fn from_name(name: &str) -> Option<Self> { match name { $($name => Some(Channel::$variant),)+ _ => None } }
        }
    };
}

channels! {
    Com "com" "rad" End true "commanded user position",
    ThetaU "theta_u" "rad" End true "user position behind the backlash",
    ThetaM "theta_m" "rad" End true "motor angle, rest angle included",
    OmegaM "omega_m" "rad/s" End true "motor speed",
    IEq "i_eq" "A" Mean true "equivalent current (|iA|+|iB|+|iC|)/2 (Eq. 4)",
    IA "i_a" "A" Mean true "current of phase A",
    IB "i_b" "A" Mean true "current of phase B",
    IC "i_c" "A" Mean true "current of phase C",
    VA "v_a" "V" Mean false "voltage of phase A against the star point",
    VB "v_b" "V" Mean false "voltage of phase B against the star point",
    VC "v_c" "V" Mean false "voltage of phase C against the star point",
    TorqueM "torque_m" "N m" Mean false "motor torque (Eq. 7)",
    IQ "i_q" "A" Mean false "signed current: half the sum of phase currents times normalised back-EMF shapes",
    ISupply "i_supply" "A" Mean false "supply current of the bridge",
    VDc "v_dc" "V" Mean false "supply voltage",
    Temperature "temperature" "deg C" Mean false "winding temperature",
}

/// A set of channels: bit `n` for channel number `n` of [`Channel::ALL`], counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct ChannelSet(pub u32);

impl ChannelSet {
    /// The basic set: command, positions, speed, currents.
    pub fn basic() -> Self {
        Self::of(Channel::ALL.iter().copied().filter(|c| c.is_basic()))
    }
    /// The set of the given channels; one that comes twice counts once.
    pub fn of(channels: impl IntoIterator<Item = Channel>) -> Self {
        Self(channels.into_iter().fold(0, |s, c| s | 1 << c as u32))
    }
    /// Whether the channel is in the set.
    pub fn contains(self, c: Channel) -> bool {
        self.0 >> c as u32 & 1 == 1
    }
    /// The set with one channel more.
    pub fn with(self, c: Channel) -> Self {
        Self(self.0 | 1 << c as u32)
    }
    /// Its channels, in the order of columns.
    pub fn iter(self) -> impl Iterator<Item = Channel> {
        Channel::ALL.iter().copied().filter(move |&c| self.contains(c))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_the_python_example_has_the_same_channels() {
        let text = include_str!("../examples/python/ema_stream.py");
        let table = text.split("CHANNELS = (").nth(1).unwrap();
        let table = table.split(")  # fmt").next().unwrap();
        let words: Vec<&str> = table.split('"').skip(1).step_by(2).collect();
        let ours: Vec<&str> = Channel::ALL.iter().flat_map(|c| [c.name(), c.unit()]).collect();
        assert_eq!(words, ours);
    }
}
