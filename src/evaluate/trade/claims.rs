//! The claims of the papers, each with the verdict that the numbers of this run give.
//!
//! No verdict is written down: each follows from a comparison of measured numbers, and the text tells them. Where a claim
//! is about all terrains, it is confirmed only if it holds on all that were measured.

mod of_thesis;

use super::{
    contender::Contender,
    document::{Claim, Ruling},
    findings::Findings,
    greatest, mean,
    meshes::Row,
};
use crate::lod::Algorithm;

const ROAM: Contender = Contender::Other(Algorithm::Published);
const QUADTREE: Contender = Contender::Other(Algorithm::Quadtree);
const GEOMIPMAP: Contender = Contender::Other(Algorithm::GeoMipMap);
/// How far a measured number may be from a printed one that is called "about" so much.
const ABOUT: f64 = 0.2;
/// What counts as a few triangles.
const A_FEW: u64 = 12;
/// What counts as little cost: a tenth.
const LITTLE: f64 = 0.1;
/// What counts as negligibly low: a hundredth.
const NEGLIGIBLE: f64 = 0.01;

/// All claims.
pub(super) fn all(found: &Findings<'_>) -> Vec<Claim> {
    vec![
        fewest_triangles(found),
        of_thesis::more_accurate_than_quadtree(found),
        of_thesis::least_geomipmap(found),
        a_third_fewer(found),
        varies_less(found),
        steps(found),
        steps_on_a_large_map(found),
        topology(found),
        strips_uniform(found),
        strips_greedy(found),
        strips_kept(found),
        vertex_bound(found),
        monotone(found),
        few_over(found),
        cascade(found),
        changed(found),
        of_thesis::averages(found),
        of_thesis::weaker_on_flat(found),
        of_thesis::best_on_jagged(found),
        of_thesis::diamonds(found),
        criteria(found),
        spheres(found),
        popping(found),
        frame_rates(),
    ]
}

fn claim(source: &'static str, claim: &'static str, ruling: Ruling, found: String) -> Claim {
    Claim { source, claim, ruling, found }
}

/// How many of how many.
fn of(held: usize, all: usize) -> (Ruling, String) {
    (Ruling::of(held == all && all > 0), format!("{held} of {all}"))
}

/// The number of triangles with which a contender's curve reaches a value, on log-log lines between what was measured.
fn reaches(rows: &[&Row], value: fn(&Row) -> f64, goal: f64) -> Option<f64> {
    let mut points: Vec<_> = rows.iter().map(|row| (row.still.triangles, value(row))).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (first, last) = (points.first()?, points.last()?);
    if first.1 <= goal {
        return Some(first.0);
    }
    let at = points.iter().position(|p| p.1 <= goal).unwrap_or(points.len());
    let [(n0, v0), (n1, v1)] = [points.get(at - 1)?, points.get(at).unwrap_or(last)].map(|p| *p);
    if v1 > goal {
        return None;
    }
    // On a straight line between the two: good enough to tell more from fewer.
    Some(n0 + (n1 - n0) * (v0 - goal) / (v0 - v1).max(f64::MIN_POSITIVE))
}

fn fewest_triangles(found: &Findings<'_>) -> Claim {
    let (mut held, mut texts) = (0, Vec::new());
    for (number, world) in found.worlds.iter().enumerate() {
        let Some(goal) = found.usual(number, ROAM).map(|row| row.still.distortion_px) else { continue };
        let needs = |contender: Contender| {
            reaches(&found.curve(number, contender), |row| row.still.distortion_px, goal).unwrap_or(f64::INFINITY)
        };
        let others = Contender::all().filter(|c| *c != ROAM && !c.is_own()).map(|c| (needs(c), c));
        let Some((least, best)) = others.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
        let own = needs(Contender::Plain);
        held += usize::from(needs(ROAM) <= least);
        let next = if least.is_finite() {
            format!("next {} with {least:.0}", best.name())
        } else {
            "no other of the papers with as many as were tried".into()
        };
        texts.push(format!(
            "{}: {:.0} triangles for {goal:.2} px at most; {next}; Sightline {own:.0}",
            world.name,
            needs(ROAM)
        ));
    }
    let (ruling, count) = of(held, texts.len());
    let text = format!("Fewest for its own distortion on {count} terrains ({}).", texts.join("; "));
    claim("Duchaineau et al.; Inam", "ROAM needs the fewest triangles.", ruling, text)
}

fn a_third_fewer(found: &Findings<'_>) -> Claim {
    let ratio = |d: &super::probes::Decision| d.triangles[1] / d.triangles[0];
    let held = found
        .probes
        .decisions
        .iter()
        .filter(|d| (ratio(d) - 2.0 / 3.0).abs() < ABOUT * 2.0 / 3.0 || ratio(d) < 2.0 / 3.0);
    let (ruling, count) = of(held.count(), found.probes.decisions.len());
    let each = found.probes.decisions.iter().map(|d| {
        let ([original, improved], [px, improved_px]) = (d.triangles, d.distortion_px);
        format!(
            "{}: {original:.0} to {improved:.0} at {:.1} px, but up to {px:.0} and {improved_px:.0} px off",
            found.name(d.world),
            d.tau_px
        )
    });
    let text = format!("On {count} terrains ({}).", each.collect::<Vec<_>>().join("; "));
    claim(
        "Ye and Wang, 4",
        "At the same error in pixels, the improved decision needs a third fewer triangles.",
        ruling,
        text,
    )
}

fn varies_less(found: &Findings<'_>) -> Claim {
    let held = found.probes.decisions.iter().filter(|d| d.variation[1] < d.variation[0]).count();
    let (ruling, count) = of(held, found.probes.decisions.len());
    let each = found.probes.decisions.iter().map(|d| {
        let [original, improved] = d.variation.map(|v| 100.0 * v);
        format!("{}: {original:.1} and {improved:.1} % of the mean", found.name(d.world))
    });
    let text = format!(
        "Standard deviation of the number of triangles over a flight with a turn, on {count} terrains less ({}).",
        each.collect::<Vec<_>>().join("; ")
    );
    claim("Ye and Wang, 4", "The improved decision varies less over a flight.", ruling, text)
}

fn steps(found: &Findings<'_>) -> Claim {
    let steps = found.probes.steps;
    let text = format!(
        "On 32 x 32 cells, which ten levels of a bintree are: {} blocks tested, {} triangles split.",
        steps.t_strip, steps.bintree
    );
    let ruling = Ruling::of(steps.t_strip == 341 && steps.bintree == 2046);
    claim("Szoka", "T-Strip takes 341 steps of subdivision where a binary tree takes 2,046.", ruling, text)
}

fn steps_on_a_large_map(found: &Findings<'_>) -> Claim {
    let steps = found.probes.steps;
    let text = format!("{} blocks tested on {} x {} cells.", steps.large, steps.large_side, steps.large_side);
    claim("Szoka", "341 steps are those of a map of 1024 x 1024.", Ruling::of(steps.large <= 341), text)
}

fn topology(found: &Findings<'_>) -> Claim {
    let ratio = |t: &super::probes::Topology, n: usize| t.transitions[n] as f64 / t.strips[n].max(1) as f64;
    let all = &found.probes.topology;
    let held = all.iter().filter(|t| (ratio(t, 1) - 1.0).abs() <= ABOUT).count();
    let (ruling, count) = of(held, all.len());
    let each = all.iter().map(|t| {
        format!("{:.2} (by distance {:.2}; {} and {} cracks)", ratio(t, 1), ratio(t, 0), t.cracks[1], t.cracks[0])
    });
    let text = format!(
        "Transition blocks for each strip at 10,000 triangles, within a fifth of 1 on {count} terrains: {}. The paper \
         gives no formula; the one used is a guess.",
        each.collect::<Vec<_>>().join("; ")
    );
    claim("Szoka", "A metric of topology makes as many transitions as strips.", ruling, text)
}

fn strips_uniform(found: &Findings<'_>) -> Claim {
    let length = found.probes.uniform_strip;
    let text = format!("Grown greedily on a mesh of one level: {length:.2} triangles in a strip.");
    claim("Duchaineau et al., 8.1", "Strips on a uniform mesh hold 8 triangles.", about(length, 8.0), text)
}

fn about(value: f64, printed: f64) -> Ruling {
    Ruling::of((value - printed).abs() <= ABOUT * printed)
}

fn strips_greedy(found: &Findings<'_>) -> Claim {
    let lengths: Vec<_> = found.probes.strips.iter().map(|s| s.greedy).collect();
    let text = format!("{:.2} on average over the terrains ({}).", mean(&lengths), listed(&lengths, 2));
    claim("Duchaineau et al., 8.1", "Greedy strips hold about 5 triangles.", about(mean(&lengths), 5.0), text)
}

fn strips_kept(found: &Findings<'_>) -> Claim {
    let strips = &found.probes.strips;
    let lengths: Vec<_> = strips.iter().map(|s| s.kept).collect();
    let slower = mean(&strips.iter().map(|s| s.slower - 1.0).collect::<Vec<_>>());
    let operations = mean(&strips.iter().map(|s| s.operations).collect::<Vec<_>>());
    let new_of = |s: &super::probes::Strips| found.usual(s.world, ROAM).map(|row| row.flown.changed);
    let came = mean(&strips.iter().filter_map(new_of).collect::<Vec<_>>());
    let length_holds = about(mean(&lengths), 4.0) == Ruling::Confirmed;
    // Without a clock there is no cost to judge by.
    let is_timed = slower.is_finite();
    let cost_holds = !is_timed || slower <= LITTLE;
    let cost = if is_timed { format!("{:.0} % of a frame's time", 100.0 * slower) } else { "not timed".into() };
    let text = format!(
        "{:.2} triangles in a strip over a flight ({}); their cost: {cost}, with {operations:.0} triangles split and merged \
         in a frame, of which {came:.0} are new when it ends.",
        mean(&lengths),
        listed(&lengths, 2)
    );
    let ruling = Ruling::of(length_holds && cost_holds);
    claim("Duchaineau et al., 8.1", "Incremental strips hold about 4 triangles at negligible cost.", ruling, text)
}

/// Numbers with commas between them.
fn listed(values: &[f64], digits: usize) -> String {
    values.iter().map(|v| format!("{v:.digits$}")).collect::<Vec<_>>().join(", ")
}

fn vertex_bound(found: &Findings<'_>) -> Claim {
    let worst = greatest(&found.probes.bounds.iter().map(|b| b.low_by).collect::<Vec<_>>());
    let share = greatest(&found.probes.bounds.iter().map(|b| b.low_share).collect::<Vec<_>>());
    let text = format!(
        "Along a triangle's sides a wedgie appears up to {worst:.3} times as thick as at its vertices; by more than 1 % \
         at {:.2} % of triangles in the picture.",
        100.0 * share
    );
    let ruling = Ruling::of(share <= NEGLIGIBLE && worst <= 1.0 + ABOUT);
    claim("Duchaineau et al., 5", "A wedgie bound taken at vertices only is negligibly low.", ruling, text)
}

fn monotone(found: &Findings<'_>) -> Claim {
    let share = |f: fn(&super::vertex_bound::Bounds) -> f64| {
        100.0 * mean(&found.probes.bounds.iter().map(f).collect::<Vec<_>>())
    };
    let (thicker, greater) = (share(|b| b.thicker), share(|b| b.greater));
    let text = format!(
        "Of pairs of a diamond and a child, the child has the thicker wedgie in {thicker:.2} %, and the greater bound on \
         the screen in {greater:.2} %."
    );
    let ruling = Ruling::of(greater.max(thicker) <= 100.0 * LITTLE);
    claim("Duchaineau et al., 5", "Wedgie bounds are generally monotone.", ruling, text)
}

fn few_over(found: &Findings<'_>) -> Claim {
    let rows = found.meshes.iter().filter(|row| row.contender == ROAM);
    let worst = rows.map(|row| row.flown.overrun).max().unwrap_or(0);
    let text = format!("A budget was overrun by {worst} triangles at most, in all flights.");
    claim(
        "Duchaineau et al., 6.3",
        "A cascade of forced splits overruns by a few triangles.",
        Ruling::of(worst <= A_FEW),
        text,
    )
}

fn cascade(found: &Findings<'_>) -> Claim {
    let [share, budget] = found.probes.cascade;
    let text = format!(
        "The worst overrun of budgets from 4 to 64 triangles was {:.0} %, at {budget:.0}: so much only where a mesh is \
         that small.",
        100.0 * share
    );
    claim("Ye and Wang, figure 1", "A forced split may bring 115 % more triangles.", Ruling::of(share >= 1.15), text)
}

fn changed(found: &Findings<'_>) -> Claim {
    let shares = |contender: Contender| -> Vec<f64> {
        let rows = found.meshes.iter().filter(|row| row.contender == contender);
        rows.map(|row| 100.0 * mean(&row.flown.changed_shares)).collect()
    };
    let (roam, own) = (shares(ROAM), shares(Contender::Plain));
    let text = format!(
        "In straight flight at 250 m/s and 30 frames a second, {} to {} % of ROAM's triangles change in a frame, {} to \
         {} % of Sightline's.",
        short(&roam)[0],
        short(&roam)[1],
        short(&own)[0],
        short(&own)[1]
    );
    claim("Duchaineau et al.", "Under 3 % of triangles change in a frame.", Ruling::of(greatest(&roam) < 3.0), text)
}

/// The least and the greatest.
fn short(values: &[f64]) -> [String; 2] {
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    [least, greatest(values)].map(|v| format!("{v:.2}"))
}

fn spheres(found: &Findings<'_>) -> Claim {
    let all = &found.probes.spheres;
    let fewer = |s: &super::probes::Spheres| 100.0 * (1.0 - s.triangles[0] as f64 / s.triangles[1] as f64);
    let held = all.iter().filter(|s| fewer(s) >= 65.0 * (1.0 - ABOUT)).count();
    let (ruling, count) = of(held, all.len());
    let each = all.iter().map(|s| {
        let ([spheres, split], [px, split_px]) = (s.triangles, s.distortion_px);
        format!("{spheres} against {split} triangles ({:.0} % fewer), {px:.1} against {split_px:.1} px off", fewer(s))
    });
    let text = format!(
        "At 3 pixels on 640 x 480 beside split-only ROAM, on {count} terrains: {}.",
        each.collect::<Vec<_>>().join("; ")
    );
    claim("Blow, after Inam", "Nested spheres need 65 % fewer triangles than ROAM at 3 pixels.", ruling, text)
}

fn criteria(found: &Findings<'_>) -> Claim {
    let of_system = |contender: Contender| found.criteria.iter().find(|row| row.contender == contender);
    let (mut fit, mut texts) = (true, Vec::new());
    for row in [GEOMIPMAP, ROAM].into_iter().filter_map(of_system) {
        fit &= row.bound == Some(true) && row.step <= LITTLE && row.far_share <= NEGLIGIBLE;
        texts.push(format!(
            "{}: a spike changes {:.2} % of far triangles, a frame the number of triangles by {:.1} % at most, its bound is \
             {}",
            row.contender.name(),
            100.0 * row.far_share,
            100.0 * row.step,
            if row.bound == Some(true) { "kept" } else { "not kept" }
        ));
    }
    let ruling = Ruling::of(fit && !texts.is_empty());
    let text = format!("{}. All systems are in the table below.", texts.join("; "));
    claim("Ye and Wang, 2.2", "GeoMipMap and ROAM fit Lindstrom's five criteria quite well.", ruling, text)
}

fn popping(found: &Findings<'_>) -> Claim {
    let counts = |row: &&Row| row.wanted == found.usual_count && row.contender != Contender::Kept;
    let at_usual = found.meshes.iter().filter(counts);
    let (mut held, mut all, mut texts) = (0, 0, Vec::new());
    for row in at_usual {
        let Some(morphed) = row.flown.morphed else { continue };
        all += 1;
        held += usize::from(morphed.largest_px < row.flown.pops.largest_px);
        texts.push(format!("{} {:.1} to {:.1}", row.contender.name(), row.flown.pops.largest_px, morphed.largest_px));
    }
    let (ruling, count) = of(held, all);
    let text = format!("The largest jump in pixels is less with morphing in {count} flights ({}).", texts.join("; "));
    claim("Ye and Wang, 2.4; Szoka", "Vertices that move gradually lessen popping.", ruling, text)
}

fn frame_rates() -> Claim {
    let text = "There is no graphics card of 2000 to 2008 here, and triangles cost modern ones next to nothing.".into();
    let what = "Frame rates: GeoMipMap beats ROAM, strips give 10 to 25 %, brute force beats ROAM, and the like.";
    claim("Ye and Wang; Szoka; White; Inam", what, Ruling::Untestable, text)
}
