//! What a person should know: errors and news, newest last, bounded.

use std::collections::VecDeque;

/// Older ones fall away.
const NOTICES_MAX: usize = 64;
/// Longer texts (of a server that sends a page) are cut.
const TEXT_CHARS_MAX: usize = 600;

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// Good to know.
    Info,
    /// Something did not work.
    Error,
}

/// One of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Notice {
    /// How bad.
    pub severity: Severity,
    /// In one line.
    pub title: String,
    /// The whole story; may be empty.
    pub detail: String,
    /// When it was last said.
    pub at_s: f64,
    /// How often in a row.
    pub count: u32,
    /// A person has seen it.
    pub dismissed: bool,
}

/// The list.
#[derive(Debug, Clone, Default)]
pub struct Notices {
    list: VecDeque<Notice>,
}

impl Notices {
    pub(crate) fn add(&mut self, severity: Severity, title: &str, detail: &str, now_s: f64) {
        let [title, detail] = [title, detail].map(short);
        // A broken server says the same with every frame: one line that counts.
        if let Some(last) = self.list.back_mut().filter(|last| last.title == title && last.detail == detail) {
            // Dismissed counts for a while, or a banner could not be got rid of.
            last.dismissed &= now_s - last.at_s < 5.0;
            (last.at_s, last.count) = (now_s, last.count.saturating_add(1));
            return;
        }
        self.list.push_back(Notice { severity, title, detail, at_s: now_s, count: 1, dismissed: false });
        if self.list.len() > NOTICES_MAX {
            self.list.pop_front();
        }
    }

    /// Oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &Notice> {
        self.list.iter()
    }

    /// The newest error that nobody has dismissed.
    pub fn newest_error(&self) -> Option<&Notice> {
        self.list.iter().rev().find(|notice| notice.severity == Severity::Error && !notice.dismissed)
    }

    /// The person has seen what there is.
    pub fn dismiss_all(&mut self) {
        self.list.iter_mut().for_each(|notice| notice.dismissed = true);
    }
}

fn short(text: &str) -> String {
    let cut: String = text.chars().take(TEXT_CHARS_MAX).collect();
    if cut.len() < text.len() { format!("{cut}…") } else { cut }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_errors_are_one_line_that_counts_and_the_list_has_an_end() {
        let mut notices = Notices::default();
        for i in 0..1000 {
            notices.add(Severity::Error, "broken picture", "bad header", f64::from(i));
        }
        assert_eq!(notices.iter().count(), 1);
        assert_eq!(notices.newest_error().unwrap().count, 1000);
        for i in 0..1000 {
            notices.add(Severity::Error, &format!("{i}"), &"x".repeat(10_000), 0.0);
        }
        assert!(notices.iter().count() <= NOTICES_MAX);
        assert!(notices.iter().all(|notice| notice.detail.len() < 1000));
        notices.dismiss_all();
        assert!(notices.newest_error().is_none());
    }
}
