//! Colours of the figures, on a light ground and on a dark one.
//!
//! A figure names its light colours, which every viewer understands; on a dark ground rules of the page (or of the file
//! that stands alone) put another colour in the place of each.

use plotters::style::RGBColor;
use std::fmt::Write as _;

pub(super) const INK: RGBColor = RGBColor(31, 41, 51);
pub(super) const MUTED: RGBColor = RGBColor(96, 108, 120);
pub(super) const FRAME: RGBColor = RGBColor(140, 150, 160);
pub(super) const GRID: RGBColor = RGBColor(230, 233, 237);
pub(super) const WHITE: RGBColor = RGBColor(255, 255, 255);
pub(super) const BAND: RGBColor = RGBColor(214, 84, 30);
pub(super) const BAND_TEXT: RGBColor = RGBColor(168, 58, 12);
pub(super) const AREA: RGBColor = RGBColor(30, 41, 59);
pub(super) const TRUTH: RGBColor = RGBColor(214, 30, 38);
pub(super) const ESTIMATE: RGBColor = RGBColor(20, 92, 214);

/// Colours of the regions: teal, amber, violet, grey, olive, rose, sky.
pub(super) const REGIONS: [RGBColor; 7] = [
    RGBColor(27, 158, 142),
    RGBColor(230, 150, 10),
    RGBColor(140, 100, 200),
    RGBColor(120, 130, 142),
    RGBColor(120, 150, 40),
    RGBColor(205, 100, 140),
    RGBColor(40, 140, 220),
];

/// Colours of the traces, told apart with colour vision deficiencies as well.
pub(super) const SERIES: [RGBColor; 8] = [
    RGBColor(0, 98, 168),
    RGBColor(213, 94, 0),
    RGBColor(0, 148, 110),
    RGBColor(170, 80, 150),
    RGBColor(214, 150, 0),
    RGBColor(70, 160, 215),
    RGBColor(70, 76, 84),
    RGBColor(140, 90, 50),
];

/// What stands for a colour on a dark ground; those that are seen on both stay as they are.
const DARK: [(RGBColor, RGBColor); 18] = [
    (WHITE, RGBColor(20, 25, 31)),
    (INK, RGBColor(227, 232, 237)),
    (MUTED, RGBColor(159, 170, 181)),
    (FRAME, RGBColor(108, 118, 128)),
    (GRID, RGBColor(42, 50, 59)),
    (BAND, RGBColor(255, 138, 92)),
    (BAND_TEXT, RGBColor(255, 160, 120)),
    (AREA, RGBColor(240, 244, 250)),
    (TRUTH, RGBColor(255, 92, 96)),
    (ESTIMATE, RGBColor(100, 165, 255)),
    (REGIONS[2], RGBColor(178, 145, 232)),
    (SERIES[0], RGBColor(86, 170, 235)),
    (SERIES[1], RGBColor(255, 140, 60)),
    (SERIES[2], RGBColor(50, 200, 155)),
    (SERIES[3], RGBColor(222, 140, 205)),
    (SERIES[6], RGBColor(170, 178, 188)),
    (SERIES[7], RGBColor(205, 155, 110)),
    // bars of noise floors
    (RGBColor(154, 165, 177), RGBColor(120, 132, 145)),
];

/// Steps of the sequential colours: few enough for each to have its counterpart.
const STEPS: u32 = 20;

/// From dark violet to green; the pale end of the scale is left out.
const LIGHT_STOPS: [(u8, u8, u8); 9] = [
    (68, 1, 84),
    (72, 36, 117),
    (65, 68, 135),
    (53, 95, 141),
    (42, 120, 142),
    (33, 145, 140),
    (34, 168, 132),
    (68, 191, 112),
    (112, 200, 72),
];

/// The same way with the dark end left out.
const DARK_STOPS: [(u8, u8, u8); 9] = [
    (206, 150, 255),
    (178, 152, 255),
    (148, 158, 250),
    (118, 168, 240),
    (92, 182, 225),
    (74, 196, 200),
    (84, 208, 170),
    (120, 218, 132),
    (166, 224, 96),
];

fn along(stops: &[(u8, u8, u8); 9], share: f64) -> RGBColor {
    let position = share.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let index = (position as usize).min(stops.len() - 2);
    let t = position - index as f64;
    let (a, b) = (stops[index], stops[index + 1]);
    let mix = |a: u8, b: u8| (f64::from(a) + t * (f64::from(b) - f64::from(a))).round() as u8;
    RGBColor(mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2))
}

/// Sequential colour of a share of 0 to 1.
pub(super) fn sequential(share: f64) -> RGBColor {
    let steps = f64::from(STEPS);
    along(&LIGHT_STOPS, (share.clamp(0.0, 1.0) * steps).round() / steps)
}

/// The rules that put the dark colours into figures.
pub(super) fn dark_rules() -> String {
    let hex = |c: RGBColor| format!("#{:02X}{:02X}{:02X}", c.0, c.1, c.2);
    let graded = (0..=STEPS).map(|k| f64::from(k) / f64::from(STEPS));
    let graded = graded.map(|s| (along(&LIGHT_STOPS, s), along(&DARK_STOPS, s)));
    let mut out = String::from("@media screen and (prefers-color-scheme: dark) {\n");
    for (light, dark) in DARK.into_iter().chain(graded) {
        let (l, d) = (hex(light), hex(dark));
        // a String takes all that is written
        let _ = writeln!(
            out,
            "svg [fill=\"{l}\" i] {{ fill: {d} }} svg [stroke=\"{l}\" i] {{ stroke: {d} }}"
        );
    }
    out + "}\n"
}
