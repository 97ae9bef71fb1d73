//! Readers that leave before all is said.

use std::process::Stdio;

use super::program;

#[test]
fn a_closed_pipe_is_no_failure() {
    let mut child = program().arg("--help").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());

    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("flat.asc");
    std::fs::write(&input, "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2\n3 4\n").unwrap();
    let output = folder.path().join("flat.sldb");
    let mut child = program()
        .arg("ingest")
        .arg(&input)
        .arg("-o")
        .arg(&output)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Both ends are closed before the program has anything to say.
    drop((child.stdout.take(), child.stderr.take()));
    assert!(child.wait().unwrap().success());
    assert!(output.exists());
}
