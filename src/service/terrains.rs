//! What terrain the server holds, and its heights.

use std::sync::Arc;

use sightline_proto::v1::{self, terrain_service_server::TerrainService};
use tonic::{Request, Response, Status};

use super::{
    MAX_HEIGHTS, ServedTerrain, Service, convert,
    status::{IntoStatus, too_many, unequal},
};
use crate::{
    exercise::{Frame, PlaceError, Site},
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
        let request = request.into_inner();
        let frame = convert::frame(request.frame)?;
        if request.x.len() != request.y.len() {
            return Err(unequal("x, y", &[request.x.len(), request.y.len()]));
        }
        if request.x.len() > MAX_HEIGHTS {
            return Err(too_many("positions in one request", request.x.len(), MAX_HEIGHTS));
        }
        let (terrain, site) = (Arc::clone(&self.0.terrain), self.0.site);
        let heights = self.0.run(move || heights(&*terrain, &site, frame, &request.x, &request.y)).await?;
        heights.map(Response::new).map_err(IntoStatus::into_status)
    }
}

fn heights(
    terrain: &impl HeightField,
    site: &Site,
    frame: Frame,
    xs: &[f64],
    ys: &[f64],
) -> Result<v1::GetHeightsResponse, PlaceError> {
    let mut response = v1::GetHeightsResponse::default();
    for (&x, &y) in xs.iter().zip(ys) {
        let [x, y] = site.grid_from_plan(frame, x, y)?;
        let height = los::on_ground(terrain, x, y, 0.0)?;
        response.z.push(height.map_or(0.0, |z| z / site.units_up(frame)));
        response.known.push(height.is_some());
    }
    Ok(response)
}
