//! Lines of sight as clients ask for them: options, streams with ids, derived questions, deadlines and cancellation.

use std::time::Instant;

use sightline::los::{self, Lines, Verdict};

use super::*;

fn batch(lines: &[[f64; 4]], up: f64) -> v1::QueryLineOfSightBatchRequest {
    let column = |k: usize| lines.iter().map(|line| line[k]).collect::<Vec<_>>();
    v1::QueryLineOfSightBatchRequest {
        frame: v1::CoordinateFrame::Grid.into(),
        altitude: v1::AltitudeReference::AboveGround.into(),
        ax: column(0),
        ay: column(1),
        az: vec![up; lines.len()],
        bx: column(2),
        by: column(3),
        bz: vec![up; lines.len()],
        ..Default::default()
    }
}

fn some_lines(salt: u32, count: u32) -> Vec<[f64; 4]> {
    (0..count).map(|n| [n * 31 % 83, (n + salt) * 17 % 61, n * 7 % 89, (n + salt) * 5 % 67].map(f64::from)).collect()
}

/// Large batches are asked in another order than they came in, small ones are not.
#[tokio::test]
async fn a_large_batch_is_answered_in_the_order_of_its_lines() {
    let (_running, client) = started().await;
    let lines = some_lines(5, 33_000);
    let all = client.query_batch(batch(&lines, 3.0)).await.unwrap();
    let mut expected = Vec::new();
    for lines in lines.chunks(1_000) {
        expected.extend(client.query_batch(batch(lines, 3.0)).await.unwrap().verdicts);
    }
    assert_eq!(all.verdicts, expected);
    let visible = expected.iter().filter(|&&v| v == v1::Verdict::Visible).count();
    assert!((3_000..30_000).contains(&visible), "{visible}");
    let mut bad = batch(&lines, 3.0);
    (bad.ax[2_000], bad.bx[1_999], bad.bx[20_000]) = (f64::NAN, f64::INFINITY, f64::NAN);
    let refused = client.query_batch(bad).await.unwrap_err().to_string();
    assert!(refused.contains("line 1999"), "{refused}");
}

#[tokio::test]
async fn a_stream_answers_each_group_under_its_ids_and_survives_a_bad_one() {
    let (_running, client) = started().await;
    let mut stream = client.stream_lines().await.unwrap();
    let mut expected = Vec::new();
    for group in 0..5_u32 {
        let lines = some_lines(group, 300);
        expected.push(client.query_batch(batch(&lines, 3.0)).await.unwrap().verdicts);
        let ids = (0..300).map(|n| u64::from(group) << 32 | n).collect();
        let mut request = batch(&lines, 3.0);
        if group == 3 {
            request.bx[7] = f64::NAN;
        }
        stream.ask(ids, request).await.unwrap();
    }
    stream.ask(vec![1, 2], batch(&some_lines(0, 3), 3.0)).await.unwrap();
    stream.ask(vec![9; MAX_STREAM_LINES + 1], batch(&vec![[1.0; 4]; MAX_STREAM_LINES + 1], 3.0)).await.unwrap();
    stream.finish();
    let (mut answered, mut refusals) = (0, Vec::new());
    while let Some(answer) = timeout(PATIENCE, stream.next()).await.unwrap().unwrap() {
        match &answer.refusal {
            Some(refusal) => refusals.push((answer.ids[0], refusal.code, refusal.message.clone())),
            None => {
                let group = (answer.ids[0] >> 32) as usize;
                assert!(answer.ids.iter().zip(0..).all(|(&id, n)| id == (group as u64) << 32 | n));
                assert_eq!(answer.verdicts().collect::<Vec<_>>(), expected[group]);
                assert!(answer.certain.iter().all(|&certain| certain));
                answered += 1;
            }
        }
    }
    refusals.sort();
    assert_eq!(answered, 4);
    let told: Vec<_> = refusals.iter().map(|(id, code, _)| (*id, *code)).collect();
    assert_eq!(told, [(1, Code::InvalidArgument as u32), (9, Code::ResourceExhausted as u32), (3 << 32, 3)]);
    assert!(refusals[2].2.contains("line 7"), "{refusals:?}");
    assert!(refusals[1].2.contains("10000"), "{refusals:?}");
}

#[tokio::test]
async fn a_client_that_does_not_read_is_not_read() {
    let (_running, client) = started().await;
    let (questions, mut answers) = client.stream_lines().await.unwrap().split();
    let questions = questions.unwrap();
    let lines = vec![[1.0, 1.0, 80.0, 60.0]; 10_000];
    // Each group takes some hundred kilobytes of the windows, so these cannot all be under way.
    let mut asked = 0;
    let group = || v1::StreamLinesOfSightRequest { ids: vec![0; 10_000], lines: Some(batch(&lines, 3.0)) };
    while asked < 200 && timeout(Duration::from_secs(3), questions.send(group())).await.is_ok() {
        asked += 1;
    }
    assert!(asked < 200, "the server takes whatever comes");
    drop(questions);
    let mut answered = 0;
    while timeout(PATIENCE, answers.message()).await.unwrap().unwrap().is_some() {
        answered += 1;
    }
    assert_eq!(answered, asked);
}

#[tokio::test]
async fn precision_and_the_earth_are_options_of_a_query() {
    let (_running, client) = started().await;
    let field = TestTerrain::new(None);
    let ask = |options: v1::QueryOptions, derive| {
        let (a, b) = (end(2.0, 3.0, 1.0), end(80.0, 60.0, 300.0));
        client.query(v1::QueryLineOfSightRequest { a, b, derive, options: Some(options), ..Default::default() })
    };
    let with = |precision: v1::Precision| v1::QueryOptions { precision: precision.into(), ..Default::default() };
    assert!(ask(with(v1::Precision::Exact), true).await.unwrap().certain);
    for precision in [v1::Precision::F64, v1::Precision::Fast] {
        assert!(!ask(with(precision), false).await.unwrap().certain);
    }
    let refused = ask(with(v1::Precision::F64), true).await;
    refusal(refused, Code::InvalidArgument, "PRECISION_EXACT");
    let negative = v1::QueryOptions { tolerance: -1.0, ..with(v1::Precision::Tolerance) };
    refusal(ask(negative, false).await, Code::InvalidArgument, "tolerance of -1");
    let flat = ask(v1::QueryOptions::default(), true).await.unwrap();
    let sphere = Some(v1::SphericalEarth { radius_m: -5.0, refraction: 0.0 });
    refusal(ask(v1::QueryOptions { sphere, ..Default::default() }, false).await, Code::InvalidArgument, "radius");
    // A small world, behind whose bulge everything hides.
    let sphere = Some(v1::SphericalEarth { radius_m: 400.0, refraction: 1.0 });
    let curved = ask(v1::QueryOptions { sphere, ..Default::default() }, true).await.unwrap();
    assert_eq!(curved.verdict(), v1::Verdict::Blocked);
    let resolved = flat.resolved.unwrap();
    let [a, b] = [resolved.a.unwrap(), resolved.b.unwrap()].map(|p| [p.x, p.y, p.z]);
    let least = los::least_target_height(&*field, a, [b[0], b[1]], Options::default()).unwrap();
    assert_eq!(flat.least_target_z, least);
    assert_eq!(flat.deepest.is_some(), flat.verdict() == v1::Verdict::Blocked);
}

#[tokio::test]
async fn stretches_are_those_of_the_library() {
    let (_running, client) = started().await;
    let field = TestTerrain::new(None);
    let (a, b) = (end(2.0, 3.0, 1.0), end(80.0, 60.0, 3.0));
    let request = v1::QueryLineOfSightRequest { a, b, stretches: true, ..Default::default() };
    let answer = client.query(request).await.unwrap();
    let resolved = answer.resolved.unwrap();
    let [a, b] = [resolved.a.unwrap(), resolved.b.unwrap()].map(|p| [p.x, p.y, p.z]);
    let line = los::line_stretches(&*field, a, b, los::Earth::Flat).unwrap();
    let ground = los::ground_stretches(&*field, a, [b[0], b[1]], los::Earth::Flat).unwrap();
    assert!(line.len() > 1 && ground.len() > 1);
    let parts = |from: f64, to: f64| [from.to_bits(), to.to_bits()];
    let told: Vec<_> = answer.line.iter().map(|s| parts(s.from, s.to)).collect();
    assert_eq!(told, line.iter().map(|s| parts(s.from, s.to)).collect::<Vec<_>>());
    let told: Vec<_> = answer.ground.iter().map(|s| parts(s.from, s.to)).collect();
    assert_eq!(told, ground.iter().map(|s| parts(s.from, s.to)).collect::<Vec<_>>());
    assert_eq!(answer.line[0].state() == v1::LineState::Above, line[0].state == los::LineState::Above);
    assert!(client.query(v1::QueryLineOfSightRequest { stretches: false, ..request }).await.unwrap().line.is_empty());
}

#[tokio::test]
async fn rays_horizons_profiles_and_normals_are_those_of_the_library() {
    let (_running, client) = started().await;
    let field = TestTerrain::new(None);
    let z = los::on_ground(&*field, 20.0, 30.0, 4.0).unwrap().unwrap();
    let from = end(20.0, 30.0, 4.0);
    let request = v1::QueryRayRequest { from, azimuth_deg: 70.0, elevation_deg: -5.0, range_m: 1_500.0, options: None };
    let answer = client.ray(request).await.unwrap();
    let to = los::ray_end([20.0, 30.0, z], 70.0, -5.0, 1_500.0, SCALE, los::Earth::Flat).unwrap();
    match los::ray(&*field, [20.0, 30.0, z], to, SCALE, los::Earth::Flat).unwrap().end {
        los::RayEnd::Hit(hit) => {
            let [x, y, z] = hit.point;
            assert_eq!((answer.end(), answer.hit), (v1::RayEnd::Hit, Some(v1::Position { x, y, z })));
        }
        other => panic!("{other:?}"),
    }
    refusal(client.ray(v1::QueryRayRequest { range_m: -1.0, ..request }).await, Code::InvalidArgument, "range");
    let azimuths_deg: Vec<f64> = (0..72).map(|n| f64::from(n) * 5.0).collect();
    let request = v1::QueryHorizonRequest { from, azimuths_deg: azimuths_deg.clone(), range_m: 1e4, options: None };
    let answer = client.horizon(request.clone()).await.unwrap();
    let expected = los::horizon(&*field, [20.0, 30.0, z], &azimuths_deg, 1e4, SCALE, los::Earth::Flat).unwrap();
    for (n, horizon) in expected.iter().enumerate() {
        assert_eq!(answer.known[n], horizon.crest.is_some());
        assert_eq!(answer.elevation_deg[n], horizon.crest.map_or(0.0, |crest| crest.elevation_deg));
    }
    let many = v1::QueryHorizonRequest { azimuths_deg: vec![0.0; 3_601], ..request.clone() };
    refusal(client.horizon(many).await, Code::ResourceExhausted, "3600");
    let nan = v1::QueryHorizonRequest { azimuths_deg: vec![0.0, f64::NAN], ..request };
    refusal(client.horizon(nan).await, Code::InvalidArgument, "azimuths_deg[1]");
    let frame = v1::CoordinateFrame::Grid.into();
    let request = v1::QueryProfileRequest { frame, ax: 0.5, ay: 3.0, bx: 60.0, by: 41.0, options: None };
    let answer = client.profile(request).await.unwrap();
    let expected = los::profile(&*field, [0.5, 3.0], [60.0, 41.0], 10_000).unwrap();
    assert_eq!(answer.ground, expected.iter().map(|b| b.ground.unwrap_or(0.0)).collect::<Vec<_>>());
    assert!(answer.bulge.is_empty());
    let sphere = Some(v1::SphericalEarth { radius_m: 5e4, refraction: 1.25 });
    let over = |precision: v1::Precision| {
        let options = Some(v1::QueryOptions { precision: precision.into(), sphere, ..Default::default() });
        client.profile(v1::QueryProfileRequest { options, ..request })
    };
    let curved = over(v1::Precision::Exact).await.unwrap();
    assert_eq!((&curved.ground, &curved.t), (&answer.ground, &answer.t));
    let [dx, dy] = [59.5 * SCALE.east_m, 38.0 * SCALE.north_m];
    for (t, bulge) in curved.t.iter().zip(&curved.bulge) {
        let expected = t * (1.0 - t) * (dx * dx + dy * dy) / (2.0 * 1.25 * 5e4 * SCALE.up_m);
        assert!((bulge - expected).abs() <= 1e-12 * expected, "{t}: {bulge}, not {expected}");
    }
    assert!(curved.bulge.len() == curved.t.len() && curved.bulge.iter().any(|&bulge| bulge > 1.0));
    refusal(over(v1::Precision::Fast).await, Code::InvalidArgument, "PRECISION_EXACT");
    let request = v1::GetHeightsRequest { frame, x: vec![4.25, -1.0], y: vec![5.5, 0.0], normals: true };
    let answer = client.heights(request).await.unwrap();
    let [east, north, up] = los::ground(&*field, SCALE, 4.25, 5.5).unwrap().unwrap().normal.unwrap();
    assert_eq!((answer.normal_east[0], answer.normal_north[0], answer.normal_up[0]), (east, north, up));
    assert_eq!((answer.known[1], answer.normal_up[1]), (false, 0.0));
}

#[tokio::test]
async fn viewsheds_and_matrices_hold_the_verdicts_of_single_lines() {
    let (_running, client) = started().await;
    let field = TestTerrain::new(None);
    let stand = |x: f64, y: f64, up: f64| [x, y, los::on_ground(&*field, x, y, up).unwrap().unwrap()];
    let rectangle = v1::PostRectangle { first_i: 10, last_i: 85, first_j: 5, last_j: 66 };
    let region = Some(v1::query_viewshed_request::Region::Rectangle(rectangle));
    let observer = end(40.5, 33.25, 6.0);
    let request = v1::QueryViewshedRequest { observer, target_height_m: 1.0, region, ..Default::default() };
    let mut tiles = client.viewshed(request).await.unwrap();
    let (mut cells, mut last) = (0, None);
    let mut lines = Lines::new(&*field);
    while let Some(tile) = timeout(PATIENCE, tiles.next()).await.unwrap().unwrap() {
        for (n, &cell) in tile.cells.iter().enumerate().filter(|(_, cell)| **cell != 0) {
            let (x, y) = (f64::from(tile.first_i + n as u32 % 64), f64::from(tile.first_j + n as u32 / 64));
            let [from, to] = [stand(40.5, 33.25, 6.0), stand(x, y, 1.0 / SCALE.up_m)];
            let expected = lines.ask(from, to, Options::default()).unwrap().verdict;
            let name = v1::Verdict::try_from(i32::from(cell)).unwrap().as_str_name();
            assert_eq!(name, format!("VERDICT_{}", expected.name()), "({x}, {y})");
            cells += 1;
        }
        last = Some((tile.done, tile.total));
    }
    assert_eq!((cells, last), (76 * 62, Some((76 * 62, 76 * 62))));
    let bare = v1::QueryViewshedRequest { observer, ..Default::default() };
    refusal(client.viewshed(bare).await, Code::InvalidArgument, "region");
    let vast = Some(v1::query_viewshed_request::Region::RadiusM(1e9));
    let vast = v1::QueryViewshedRequest { observer, region: vast, ..Default::default() };
    refusal(client.viewshed(vast).await, Code::ResourceExhausted, "100000000");
    let places: Vec<[f64; 2]> = (0..20_u32).map(|n| [n * 37 % 88, n * 53 % 68].map(f64::from)).collect();
    let request = v1::QueryIntervisibilityRequest {
        frame: v1::CoordinateFrame::Grid.into(),
        altitude: v1::AltitudeReference::AboveGround.into(),
        x: places.iter().map(|p| p[0]).collect(),
        y: places.iter().map(|p| p[1]).collect(),
        z: vec![5.0; 20],
        ..Default::default()
    };
    let matrix = client.intervisibility(request).await.unwrap();
    let mut seen = 0;
    for (row, verdicts) in matrix.iter().enumerate() {
        assert_eq!(verdicts.len(), 19 - row);
        for (n, verdict) in verdicts.iter().enumerate() {
            let [from, to] = [places[row], places[row + 1 + n]].map(|[x, y]| stand(x, y, 5.0));
            let expected = lines.ask(from, to, Options::default()).unwrap().verdict;
            assert_eq!(verdict.as_str_name(), format!("VERDICT_{}", expected.name()));
            seen += u32::from(expected == Verdict::Visible);
        }
    }
    assert!(seen > 5, "{seen}");
}

/// A terrain whose pages take their time, and counts them.
fn slow(field: &TestTerrain) -> u64 {
    field.reads.load(Ordering::Relaxed)
}

#[tokio::test]
async fn work_stops_when_the_deadline_passes_or_the_client_goes() {
    let terrain = TestTerrain::new(None);
    let running = Running::start(Arc::clone(&terrain), Limits::default()).await;
    let channel = tonic::transport::Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    let mut raw = v1::line_of_sight_service_client::LineOfSightServiceClient::new(channel.connect().await.unwrap());
    terrain.slow.store(true, Ordering::Relaxed);
    // Each line reads pages anew, and each reading takes a millisecond: minutes in all.
    let lines = some_lines(1, 100_000);
    let started = Instant::now();
    let mut request = tonic::Request::new(batch(&lines, 3.0));
    request.set_timeout(Duration::from_millis(400));
    let end = match raw.query_line_of_sight_batch(request).await {
        Err(status) => status,
        Ok(answers) => {
            let mut answers = answers.into_inner();
            loop {
                match answers.message().await {
                    Ok(Some(_)) => {}
                    Ok(None) => panic!("all of it was computed"),
                    Err(status) => break status,
                }
            }
        }
    };
    assert!(matches!(end.code(), Code::DeadlineExceeded | Code::Cancelled), "{end}");
    assert!(started.elapsed() < PATIENCE);
    settles(&terrain).await;
    let answers = raw.query_line_of_sight_batch(batch(&lines, 3.0)).await.unwrap();
    tokio::time::sleep(Duration::from_millis(200)).await;
    drop(answers);
    settles(&terrain).await;
    // The server is as ready as before.
    terrain.slow.store(false, Ordering::Relaxed);
    let client = running.client().await;
    assert_eq!(client.query_batch(batch(&lines[..10], 3.0)).await.unwrap().verdicts.len(), 10);
}

/// Waits until nothing is read any more, which must come soon.
async fn settles(terrain: &TestTerrain) {
    let patience = Instant::now();
    loop {
        let before = slow(terrain);
        tokio::time::sleep(Duration::from_millis(300)).await;
        if slow(terrain) == before {
            return;
        }
        assert!(patience.elapsed() < PATIENCE, "the server works on for nobody");
    }
}
