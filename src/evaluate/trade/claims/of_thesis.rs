//! The claims of Inam's "Evaluation of Terrain Rendering Algorithms", 2005.

use super::{
    super::{
        contender::Contender,
        document::{Claim, Ruling},
        findings::Findings,
        mean,
        noise::Method,
        printed::{AT_10_000, AVERAGES, LEAST_GEOMIPMAP},
        thesis,
    },
    GEOMIPMAP, QUADTREE, ROAM, claim, of, short,
};

pub(super) fn more_accurate_than_quadtree(found: &Findings<'_>) -> Claim {
    let pairs = found.pairs(2, ROAM, QUADTREE);
    let held = pairs.iter().filter(|(roam, quadtree)| roam.accuracy > quadtree.accuracy).count();
    let (ruling, count) = of(held, pairs.len());
    let each = pairs.iter().map(|(r, q)| format!("{} {:.2} against {:.2} %", r.set, r.accuracy, q.accuracy));
    let text = format!(
        "On {count} terrains ({}). Printed: {:.2} against {:.2} and {:.2} against {:.2} %.",
        each.collect::<Vec<_>>().join(", "),
        AT_10_000[0][0].accuracy,
        AT_10_000[0][1].accuracy,
        AT_10_000[1][0].accuracy,
        AT_10_000[1][1].accuracy
    );
    claim("Inam, tables 3.27, 3.28", "ROAM is more accurate than the quadtree at 10,000 triangles.", ruling, text)
}

pub(super) fn least_geomipmap(found: &Findings<'_>) -> Claim {
    let [posts, triangles] = found.probes.coarsest;
    // On a smaller map, the printed number for as many tiles.
    let printed = f64::from(LEAST_GEOMIPMAP) * (posts as f64 / 1025.0) * (posts as f64 / 1025.0);
    let ruling = Ruling::of(triangles as f64 >= 0.9 * printed);
    let why = if ruling == Ruling::Refuted { " It was a limit of that program, not of the method." } else { "" };
    let text = format!(
        "The coarsest mesh of {posts} x {posts} posts in tiles of 33 x 33 has {triangles} triangles, {:.2} times the \
         {printed:.0} of the claim.{why}",
        triangles as f64 / printed
    );
    claim(
        "Inam, 3.4.2",
        "GeoMipMap cannot go below 40,000 triangles at 1025 x 1025 with tiles of 33 x 33.",
        ruling,
        text,
    )
}

pub(super) fn averages(found: &Findings<'_>) -> Claim {
    let mean_of = |contender: Contender, value: fn(&thesis::Row) -> f64| {
        let rows = found.thesis.iter().filter(|row| row.case == 1 && row.contender == contender);
        mean(&rows.map(value).collect::<Vec<_>>())
    };
    let of_all = [ROAM, QUADTREE, GEOMIPMAP].map(|contender| mean_of(contender, |row| row.accuracy));
    let order = |a: [f64; 3]| a[0] < a[1] && a[1] < a[2];
    let text = format!(
        "Averages here, at as many triangles: {:.2}, {:.2} and {:.2} %; printed {:.2}, {:.2} and {:.2} %. The order ROAM, \
         quadtree, GeoMipMap {} here. Its terrains, cameras and settings are not known, and its numbers of triangles \
         differ by a factor of {:.1} between the systems that it compares.",
        of_all[0],
        of_all[1],
        of_all[2],
        AVERAGES[0].accuracy,
        AVERAGES[1].accuracy,
        AVERAGES[2].accuracy,
        if order(of_all) { "comes out" } else { "does not come out" },
        f64::from(AVERAGES[2].triangles) / f64::from(AVERAGES[0].triangles)
    );
    claim(
        "Inam, table 4.1",
        "ROAM averages 95.53 %, the quadtree 98.34 %, GeoMipMap 98.50 %.",
        Ruling::NotReproducible,
        text,
    )
}

pub(super) fn weaker_on_flat(found: &Findings<'_>) -> Claim {
    let of_roam = |method: Method| {
        found.thesis.iter().find(|r| r.is_synthetic && r.case == 2 && r.contender == ROAM && r.set == method.name())
    };
    let (mut held, mut nearer, mut texts) = (0, 0, Vec::new());
    for [flat, jagged] in Method::OPPOSITES {
        let (Some(flat), Some(jagged)) = (of_roam(flat), of_roam(jagged)) else { continue };
        held += usize::from(flat.accuracy < jagged.accuracy);
        nearer += usize::from(flat.mean_difference < jagged.mean_difference);
        texts.push(format!(
            "{} {:.2} %, {:.2} steps of height off; {} {:.2} %, {:.2} steps",
            flat.set, flat.accuracy, flat.mean_difference, jagged.set, jagged.accuracy, jagged.mean_difference
        ));
    }
    let (ruling, count) = of(held, texts.len());
    let text = format!(
        "At 10,000 triangles ROAM has less accuracy on the kind with more plains in {count} pairs, and is nearer to the \
         ground there in {nearer} ({}). The formula divides by the heights, which are low on plains.",
        texts.join("; ")
    );
    claim("Inam, 3.5", "ROAM is weaker on flat terrain.", ruling, text)
}

pub(super) fn best_on_jagged(found: &Findings<'_>) -> Claim {
    let jagged: Vec<_> = found.thesis.iter().filter(|r| r.is_jagged && r.case == 2).collect();
    let mut sets: Vec<&str> = jagged.iter().map(|row| row.set.as_str()).collect();
    sets.dedup();
    let (mut held, mut texts) = (0, Vec::new());
    for set in &sets {
        let of_set = || jagged.iter().filter(|row| row.set == *set && !row.contender.is_own());
        let Some(best) = of_set().max_by(|a, b| a.accuracy.total_cmp(&b.accuracy)) else { continue };
        held += usize::from(best.contender == QUADTREE);
        let each = of_set().map(|row| format!("{} {:.2} %", row.contender.name(), row.accuracy));
        texts.push(format!("{set}: {}", each.collect::<Vec<_>>().join(", ")));
    }
    let (ruling, count) = of(held, sets.len());
    let text = format!("At 10,000 triangles, best on {count} ridged terrains ({}).", texts.join("; "));
    claim("Inam, 3.5", "The quadtree is best on large, sharp and jagged terrain.", ruling, text)
}

pub(super) fn diamonds(found: &Findings<'_>) -> Claim {
    let pairs = found.pairs(2, Contender::Plain, ROAM);
    let held = pairs.iter().filter(|(own, roam)| own.accuracy > roam.accuracy).count();
    let (ruling, count) = of(held, pairs.len());
    let ratios: Vec<_> = pairs.iter().map(|(own, roam)| own.mean_difference / roam.mean_difference).collect();
    let text = format!(
        "Sightline, whose queues hold diamonds, is more accurate than ROAM as published at 10,000 triangles on {count} \
         terrains; mean differences are {} to {} times those of ROAM.",
        short(&ratios)[0],
        short(&ratios)[1]
    );
    claim("Inam, future work", "Diamonds instead of a binary tree give better accuracy.", ruling, text)
}
