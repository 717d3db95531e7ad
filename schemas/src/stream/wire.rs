//! Structures in shared memory: one table each gives the structure, its name on the wire and its
//! fingerprint. iceoryx2 compares types by name, size and alignment only, so the name holds the
//! schema version and a fingerprint of every field.

use crate::feature::Feature;

/// A field's value before anything is written into it.
pub trait Blank {
    /// Zero, or all zeros.
    const BLANK: Self;
}
impl Blank for u32 {
    const BLANK: Self = 0;
}
impl Blank for u64 {
    const BLANK: Self = 0;
}
impl Blank for i64 {
    const BLANK: Self = 0;
}
impl Blank for f64 {
    const BLANK: Self = 0.0;
}
impl<const N: usize> Blank for [u8; N] {
    const BLANK: Self = [0; N];
}
impl<const N: usize> Blank for [f64; N] {
    const BLANK: Self = [0.0; N];
}

/// One number for each feature of [`Feature::TOLD`]: on the wire each is a field of its own, named by its key.
pub type FeatureNumbers = [f64; Feature::TOLD.len()];

/// A field of a structure in shared memory: name, type and offset in bytes.
pub type WireField = (&'static str, &'static str, usize);

/// `ema::NAME/VERSION/FINGERPRINT`: what both ends of a service must agree on.
pub(super) fn type_name(name: &str, fields: &[WireField], more: &str) -> String {
    let mut text = String::new();
    for &(field, kind, offset) in fields {
        if kind == "FeatureNumbers" {
            let keys = Feature::TOLD.iter().map(|f| f.key()).zip(0..);
            text.extend(keys.map(|(key, k)| format!("{key}:f64@{};", offset + k * size_of::<f64>())));
        } else {
            text += &format!("{field}:{kind}@{offset};");
        }
    }
    let hash = crate::fingerprint::fingerprint(&(text + more));
    format!("ema::{name}/{}/{}", crate::SCHEMA_VERSION, &hash[..8])
}

macro_rules! wire {
    ($(#[$doc:meta])* $name:ident ($more:expr) { $($(#[$field_doc:meta])* $field:ident: $kind:ty),+ $(,)? }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name { $($(#[$field_doc])* pub $field: $kind),+ }

        impl $name {
            /// Every field with type and offset, in order.
            pub const FIELDS: &'static [$crate::stream::wire::WireField] =
                &[$((stringify!($field), stringify!($kind), std::mem::offset_of!($name, $field))),+];

            /// Name on the wire.
            pub fn wire_name() -> &'static str {
                static NAME: std::sync::LazyLock<String> = std::sync::LazyLock::new(|| {
                    $crate::stream::wire::type_name(stringify!($name), $name::FIELDS, $more)
                });
                &NAME
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: <$kind as $crate::stream::wire::Blank>::BLANK),+ }
            }
        }

        // SAFETY: plain numbers and byte arrays in a fixed layout, without pointers
        unsafe impl iceoryx2::prelude::ZeroCopySend for $name {
            unsafe fn type_name() -> &'static str {
                $name::wire_name()
            }
        }
    };
}
pub(super) use wire;

/// UTF-8 in a fixed field, cut at a character's end and padded with zeros.
pub fn to_text<const N: usize>(text: &str) -> [u8; N] {
    let mut end = text.len().min(N);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let mut out = [0; N];
    out[..end].copy_from_slice(&text.as_bytes()[..end]);
    out
}

/// The text of a fixed field.
pub fn from_text(field: &[u8]) -> String {
    let end = field.iter().position(|&b| b == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).into_owned()
}

/// A fingerprint as a number: `none` is 0, unknown (empty) is all ones.
pub fn to_number(fingerprint: &str) -> u64 {
    match fingerprint {
        "none" => 0,
        text => u64::from_str_radix(text, 16).unwrap_or(u64::MAX),
    }
}

/// The fingerprint of a number of [`to_number`].
pub fn from_number(number: u64) -> String {
    match number {
        0 => "none".into(),
        u64::MAX => String::new(),
        n => format!("{n:016x}"),
    }
}
