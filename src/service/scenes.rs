//! The scene service: a view on a stream of its own, or on a watch.

use sightline_proto::v1::{self, scene_service_server::SceneService, stream_scene_request::Request as Wish};
use tokio::time::timeout;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

use super::{OPENING_TIME, ServedTerrain, Service, access::Caller, admission::explained, views, watches};

#[tonic::async_trait]
impl<T: ServedTerrain> SceneService for Service<T> {
    type StreamSceneStream = ReceiverStream<Result<v1::StreamSceneResponse, Status>>;

    async fn stream_scene(
        &self,
        request: Request<Streaming<v1::StreamSceneRequest>>,
    ) -> Result<Response<Self::StreamSceneStream>, Status> {
        let caller = Caller::of(&request);
        let mut inbox = request.into_inner();
        let open = opening(&mut inbox).await.map_err(|status| explained(status, self.0.limits.request_bytes))?;
        let said = views::open(&self.0, &caller, open, Box::pin(inbox)).await?;
        Ok(Response::new(ReceiverStream::new(said)))
    }

    type WatchViewsStream = watches::WatchStream;

    async fn watch_views(&self, _: Request<v1::WatchViewsRequest>) -> Result<Response<Self::WatchViewsStream>, Status> {
        watches::begin(&self.0).map(Response::new)
    }

    async fn open_watched_view(
        &self,
        request: Request<v1::OpenWatchedViewRequest>,
    ) -> Result<Response<v1::OpenWatchedViewResponse>, Status> {
        let caller = Caller::of(&request);
        watches::open(&self.0, &caller, request.into_inner()).await?;
        Ok(Response::new(v1::OpenWatchedViewResponse {}))
    }

    async fn tell_watched_view(
        &self,
        request: Request<v1::TellWatchedViewRequest>,
    ) -> Result<Response<v1::TellWatchedViewResponse>, Status> {
        watches::tell(&self.0, request.into_inner()).await?;
        Ok(Response::new(v1::TellWatchedViewResponse {}))
    }

    async fn close_watched_view(
        &self,
        request: Request<v1::CloseWatchedViewRequest>,
    ) -> Result<Response<v1::CloseWatchedViewResponse>, Status> {
        watches::close(&self.0, &request.into_inner())?;
        Ok(Response::new(v1::CloseWatchedViewResponse {}))
    }
}

/// The first message, which must open the view.
async fn opening(inbox: &mut Streaming<v1::StreamSceneRequest>) -> Result<v1::OpenView, Status> {
    let first = timeout(OPENING_TIME, inbox.message()).await;
    let first = first.map_err(|_| Status::deadline_exceeded("the client did not say what view it wants"))??;
    match first.and_then(|first| first.request) {
        Some(Wish::Open(open)) => Ok(open),
        _ => Err(Status::invalid_argument("the first message of a view must open it")),
    }
}
