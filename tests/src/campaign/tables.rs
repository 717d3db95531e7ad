//! Rates, medians and Markdown tables.

use super::score::wilson;

/// A rate in per cent with its bounds.
pub fn rate(k: usize, n: usize) -> String {
    if n == 0 {
        return "-".into();
    }
    let (lo, hi) = wilson(k, n);
    let p = k as f64 / n as f64;
    format!("{:.1} [{:.1}, {:.1}]", 100.0 * p, 100.0 * lo, 100.0 * hi)
}

/// `None` where there is nothing.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut v: Vec<f64> = values.into_iter().filter(|x| !x.is_nan()).collect();
    v.sort_by(f64::total_cmp);
    let n = v.len();
    match n {
        0 => None,
        _ if n % 2 == 1 => Some(v[n / 2]),
        _ => Some(0.5 * (v[n / 2 - 1] + v[n / 2])),
    }
}

/// A number, or a dash.
pub fn shown(x: Option<f64>, digits: usize) -> String {
    x.map_or("-".into(), |x| format!("{x:.digits$}"))
}

/// A Markdown table.
pub fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let head: Vec<String> = head.iter().map(|h| h.to_string()).collect();
    let mut out = line(&head);
    out += &format!("|{}\n", "---|".repeat(head.len()));
    rows.iter().for_each(|r| out += &line(r));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median([3.0, f64::NAN, 1.0]), Some(2.0));
        assert_eq!(median([3.0, 9.0, 1.0]), Some(3.0));
        assert_eq!(median([f64::NAN]), None);
        assert_eq!(shown(None, 2), "-");
    }

    #[test]
    fn rates_and_tables() {
        assert_eq!(rate(97, 100), "97.0 [91.5, 99.0]");
        assert_eq!(rate(0, 0), "-");
        let t = table(&["a", "b"], &[vec!["1".into(), "2".into()]]);
        assert_eq!(t, "| a | b |\n|---|---|\n| 1 | 2 |\n");
    }
}
