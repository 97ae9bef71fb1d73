//! What terrain the server holds, and its heights.

use std::sync::Arc;

use sightline_proto::v1::{self, terrain_service_server::TerrainService};
use tonic::{Request, Response, Status};

use super::{
    MAX_HEIGHTS, ServedTerrain, Service, convert,
    status::{IntoStatus, too_many, unequal},
    wanted::Wanted,
};
use crate::{
    exercise::{Frame, Site},
    los,
    terrain::HeightField,
};

#[tonic::async_trait]
impl<T: ServedTerrain> TerrainService for Service<T> {
    async fn describe_terrain(
        &self,
        _: Request<v1::DescribeTerrainRequest>,
    ) -> Result<Response<v1::DescribeTerrainResponse>, Status> {
        Ok(Response::new(v1::DescribeTerrainResponse { terrain: Some(self.0.description.clone()) }))
    }

    async fn get_heights(
        &self,
        request: Request<v1::GetHeightsRequest>,
    ) -> Result<Response<v1::GetHeightsResponse>, Status> {
        // The call is dropped with this future, which is when the client cancels.
        let wanted = Wanted::of(&request);
        let request = request.into_inner();
        let frame = convert::frame(request.frame)?;
        if request.x.len() != request.y.len() {
            return Err(unequal("x, y", &[request.x.len(), request.y.len()]));
        }
        if request.x.len() > MAX_HEIGHTS {
            return Err(too_many("positions in one request", request.x.len(), MAX_HEIGHTS));
        }
        let (terrain, site) = (Arc::clone(&self.0.terrain), self.0.site);
        let (wanted, _call) = wanted;
        let heights = self.0.run(move || heights(&*terrain, &site, frame, &request, &wanted)).await?;
        heights.map(Response::new)
    }
}

/// Positions between two questions whether the call is still wanted.
const SHARE_POSITIONS: usize = 1_024;

fn heights(
    terrain: &impl HeightField,
    site: &Site,
    frame: Frame,
    request: &v1::GetHeightsRequest,
    wanted: &Wanted,
) -> Result<v1::GetHeightsResponse, Status> {
    let mut response = v1::GetHeightsResponse::default();
    for (n, (&x, &y)) in request.x.iter().zip(&request.y).enumerate() {
        if n % SHARE_POSITIONS == 0 {
            wanted.check()?;
        }
        let named = |status: Status| Status::new(status.code(), format!("position {n}: {}", status.message()));
        let [x, y] = site.grid_from_plan(frame, x, y).map_err(|error| named(error.into_status()))?;
        let height = los::on_ground(terrain, x, y, 0.0).map_err(|error| named(error.into_status()))?;
        response.z.push(height.map_or(0.0, |z| z / site.units_up(frame)));
        response.known.push(height.is_some());
        if request.normals {
            let ground = los::ground(terrain, site.scale, x, y).map_err(|error| named(error.into_status()))?;
            let [east, north, up] = ground.and_then(|ground| ground.normal).unwrap_or_default();
            response.normal_east.push(east);
            response.normal_north.push(north);
            response.normal_up.push(up);
        }
    }
    Ok(response)
}
