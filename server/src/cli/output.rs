//! Facts on standard output.

use std::io::{self, ErrorKind, Write};

use super::CliError;

/// Prints `text` and a line end. A reader that has gone (`lumicast info … | head`) has seen what it wanted.
pub(super) fn print_line(text: &str) -> Result<(), CliError> {
    print_to(&mut io::stdout().lock(), text)
}

fn print_to(out: &mut impl Write, text: &str) -> Result<(), CliError> {
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(source) if source.kind() != ErrorKind::BrokenPipe => {
            Err(CliError::System { doing: "writing to standard output".into(), source })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Broken(ErrorKind);

    impl Write for Broken {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(self.0.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// A reader that has gone is no error; a full disk behind standard output is.
    #[test]
    fn only_a_reader_that_has_gone_is_forgiven() {
        assert!(print_to(&mut Broken(ErrorKind::BrokenPipe), "x").is_ok());
        let error = print_to(&mut Broken(ErrorKind::StorageFull), "x").unwrap_err();
        assert!(error.to_string().contains("standard output"));
        let mut text = Vec::new();
        print_to(&mut text, "facts").unwrap();
        assert_eq!(text, b"facts\n");
    }
}
