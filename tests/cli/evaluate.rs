//! The trade report's verb. What it measures is tested beside it; a run takes too long for here.

use super::{sightline, status, text};

#[test]
fn what_cannot_be_is_refused_before_anything_is_measured() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let missing = sightline(&["evaluate", "--quick", "--dem", &path("none.tif"), "-o", &path("report")]);
    assert_eq!(status(&missing), 3);
    assert!(text(&missing.stderr).contains("none.tif: no such file"), "{missing:?}");
    std::fs::write(folder.path().join("report.html"), "mine").expect("written");
    let existing = sightline(&["evaluate", "--quick", "-o", &path("")]);
    assert_eq!(status(&existing), 4);
    assert!(text(&existing.stderr).contains("give --force to replace it"), "{existing:?}");
    assert_eq!(std::fs::read_to_string(folder.path().join("report.html")).expect("read"), "mine");
}
