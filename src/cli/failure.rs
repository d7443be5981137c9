//! A failure as one paragraph for a person.

/// The error and its causes, each said once: many messages of the library already tell what the
/// system said, for readers who see nothing but them.
pub(super) fn message(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        // A blank line would look like the end of the message.
        let lines: Vec<&str> = cause.lines().filter(|line| !line.trim().is_empty()).collect();
        let cause = lines.join("\n");
        if text.contains(&cause) {
            continue;
        }
        if !text.is_empty() {
            text.push_str(": ");
        }
        text.push_str(&cause);
    }
    text
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;
    use crate::export::ExportError;

    #[test]
    fn every_cause_is_said_once() {
        let source = io::Error::other("the disk is on fire");
        let told = ExportError::Read { path: "a.ply".into(), source };
        let error = anyhow::Error::from(told).context("no mesh");
        let text = message(&error);
        assert!(text.starts_with("no mesh: cannot read a.ply: the disk is on fire"), "{text}");
        assert_eq!(text.matches("on fire").count(), 1, "{text}");
        let untold = anyhow::Error::from(io::Error::other("the disk\n\nis full\n")).context("cannot save");
        assert_eq!(message(&untold), "cannot save: the disk\nis full");
    }
}
