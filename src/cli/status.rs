//! `sightline status`: how a server is.

use sightline_client::v1;

use super::{Context, Failure, connect, generator::runtime};

/// Show how a server is: health, what is in use of its limits, frames, verdicts, bytes.
///
/// Exit status 1 when it is not healthy. `/metrics` on the same port has everything that is measured.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// Address of the server.
    #[arg(value_name = "ADDR")]
    address: String,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let status = runtime()?
            .block_on(async { connect::connect(&self.address).await?.status().await.map_err(connect::failure) })?;
        if context.json {
            outln!("{:#}", document(&status));
        } else {
            tell(&status);
        }
        if status.serving { Ok(()) } else { Err(Failure::Found(status.troubles.join("; "))) }
    }
}

fn document(s: &v1::GetStatusResponse) -> serde_json::Value {
    let limits: serde_json::Map<_, _> =
        s.limits.iter().map(|l| (l.name.clone(), serde_json::json!({ "used": l.used, "limit": l.limit }))).collect();
    let recording = s.recording.as_ref().map(
        |r| serde_json::json!({ "bytes": r.bytes, "limit_bytes": r.limit_bytes, "ended": (!r.ended.is_empty()).then_some(&r.ended) }),
    );
    serde_json::json!({
        "version": s.version, "uptime_s": s.uptime_s, "serving": s.serving, "troubles": s.troubles, "limits": limits,
        "calls": s.calls, "refused_calls": s.refused_calls, "frames": s.frames, "frame_median_ms": s.frame_median_ms,
        "frame_p99_ms": s.frame_p99_ms, "queue_age_ms": s.queue_age_ms, "visible": s.visible, "blocked": s.blocked,
        "unknown": s.unknown, "exact_signs": s.exact_signs, "unsatisfied_lines": s.unsatisfied_lines,
        "received_bytes": s.received_bytes, "sent_bytes": s.sent_bytes, "recording": recording,
    })
}

fn tell(s: &v1::GetStatusResponse) {
    let health = if s.serving { "serving".to_owned() } else { format!("NOT serving: {}", s.troubles.join("; ")) };
    outln!("sightline {}, up {:.0} s, {health}", s.version, s.uptime_s);
    for limit in &s.limits {
        outln!("{:<12} {} of {}", limit.name, limit.used, limit.limit);
    }
    outln!("calls        {}, {} of them refused", s.calls, s.refused_calls);
    outln!(
        "frames       {}, made in {} ms (median) and {} ms (p99) at most; oldest work waits {:.0} ms",
        s.frames,
        s.frame_median_ms,
        s.frame_p99_ms,
        s.queue_age_ms
    );
    let lines = s.visible + s.blocked + s.unknown;
    let share = if lines == 0 { 0.0 } else { s.exact_signs as f64 / lines as f64 };
    outln!("lines        {} visible, {} blocked, {} unknown", s.visible, s.blocked, s.unknown);
    outln!("exact signs  {}, {share:.4} a line asked (those of frames included)", s.exact_signs);
    outln!("unsatisfied  {} lines over all views", s.unsatisfied_lines);
    outln!("bytes        {} received, {} sent", s.received_bytes, s.sent_bytes);
    if let Some(recording) = &s.recording {
        let how = if recording.ended.is_empty() { "goes on" } else { recording.ended.as_str() };
        outln!("recording    {} of {} bytes; {how}", recording.bytes, recording.limit_bytes);
    }
}
