//! Recorded sessions as `clients/README.md` specifies them: JSON, one line a message.

use serde_json::{Value, json};
use sightline_client::scene::SceneState;
use sightline_proto::verdict::MeshVerdict;

/// What a client must hold after a frame.
pub(crate) fn held(scene: &SceneState) -> Value {
    let letter = |verdict| if verdict == MeshVerdict::Visible { 'V' } else { 'B' };
    let verdicts: Vec<_> = scene.verdicts().collect();
    json!({
        "sequence": scene.last_frame().sequence,
        "epoch": scene.last_frame().epoch,
        "triangles": scene.replica().triangle_count(),
        "hash": format!("{:016x}", scene.replica().hash()),
        "lines": verdicts.iter().map(|(id, _)| id.to_string()).collect::<Vec<_>>(),
        "verdicts": verdicts.iter().map(|&(_, verdict)| letter(verdict)).collect::<String>(),
        "unsatisfied": scene.unsatisfied().keys().map(u64::to_string).collect::<Vec<_>>(),
        "lacking": scene.unsatisfied().values().map(|line| line.lacking_triangles).collect::<Vec<_>>(),
        "off_ground": scene.off_ground().iter().map(u64::to_string).collect::<Vec<_>>(),
    })
}

/// Bytes as hexadecimal digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
