//! Numbers as people read them.

/// `1234567` → `1.23 M`; whole below a thousand.
pub fn count(value: f64) -> String {
    match value {
        v if !v.is_finite() => "–".into(),
        v if v.abs() < 1e3 => format!("{v:.0}"),
        v if v.abs() < 1e6 => format!("{:.3} k", Short(v / 1e3)),
        v if v.abs() < 1e9 => format!("{:.3} M", Short(v / 1e6)),
        v => format!("{:.3} G", Short(v / 1e9)),
    }
}

/// Bytes a second.
pub fn byte_rate(bytes_per_second: f64) -> String {
    match bytes_per_second {
        v if v < 1e3 => format!("{v:.0} B/s"),
        v if v < 1e6 => format!("{:.0} kB/s", v / 1e3),
        v => format!("{:.2} MB/s", v / 1e6),
    }
}

/// A fraction as percent, to three figures: `0.0312` → `3.12 %`.
pub fn percent(fraction: f64) -> String {
    format!("{:.3} %", Short(fraction * 100.0))
}

/// Milliseconds, or seconds from one on.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 0.0995 => format!("{:.1} ms", s * 1e3),
        s if s < 1.0 => format!("{:.0} ms", s * 1e3),
        s if s < 100.0 => format!("{s:.1} s"),
        s if s < 6000.0 => format!("{:.0} min {:.0} s", (s / 60.0).floor(), s % 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// A number to as many figures as the format's precision asks for, without an exponent.
struct Short(f64);

impl std::fmt::Display for Short {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let figures = f.precision().unwrap_or(3) as i32;
        let magnitude = if self.0 == 0.0 { 0 } else { self.0.abs().log10().floor() as i32 };
        // Six places are enough for a millionth of a percent.
        let places = (figures - 1 - magnitude).clamp(0, 6) as usize;
        write!(f, "{:.places$}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_figures_are_kept_whatever_the_size() {
        assert_eq!(percent(0.0312), "3.12 %");
        assert_eq!(percent(0.312), "31.2 %");
        assert_eq!(percent(3.12), "312 %");
        assert_eq!(percent(0.00004), "0.00400 %");
        assert_eq!(count(999.0), "999");
        assert_eq!(count(66_450.0), "66.5 k");
        assert_eq!(count(2_400_000.0), "2.40 M");
        assert_eq!(byte_rate(85_000.0), "85 kB/s");
        assert_eq!(duration(0.0123), "12.3 ms");
        assert_eq!(duration(0.25), "250 ms");
        assert_eq!(duration(75.0), "75.0 s");
        assert_eq!(duration(125.0), "2 min 5 s");
    }
}
