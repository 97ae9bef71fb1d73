//! Standard output and standard error, whose readers may leave at any time.
//!
//! A closed pipe (`sightline info DB | head`) is no failure: what is said after it is not heard. Anything else that
//! keeps results from being printed, such as a full disk, ends the program with status 4, because a result that is
//! lost in silence is worse. The macros of the standard library panic in both cases.

use std::{
    fmt::Arguments,
    io::{self, ErrorKind, Write},
    process,
};

/// Prints results, as `print!` does.
macro_rules! out {
    ($($text:tt)*) => { $crate::cli::say::results(format_args!($($text)*)) };
}

/// Prints results and a line end, as `println!` does.
macro_rules! outln {
    ($($text:tt)*) => { $crate::cli::say::results(format_args!("{}\n", format_args!($($text)*))) };
}

/// Prints a remark and a line end on standard error, as `eprintln!` does.
macro_rules! errln {
    ($($text:tt)*) => { $crate::cli::say::remark(format_args!("{}\n", format_args!($($text)*))) };
}

/// Writes `text` to standard output.
pub(super) fn results(text: Arguments<'_>) {
    let mut stdout = io::stdout().lock();
    match stdout.write_fmt(text).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            remark(format_args!("sightline: standard output: {error}\n"));
            process::exit(4)
        }
        _ => {}
    }
}

/// Writes `text` to standard error. There is nowhere to say that this failed.
pub(super) fn remark(text: Arguments<'_>) {
    let _ = io::stderr().lock().write_fmt(text);
}
