//! What follows from lines of sight: rays, horizons, profiles, viewsheds, matrices, and questions as they arise.

use sightline_proto::v1;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

use crate::{Client, ClientError};

/// Groups that wait in a [`LineStream`] to be sent.
const WAITING_GROUPS: usize = 2;

/// Questions as they arise, and their answers as they are ready.
#[derive(Debug)]
pub struct LineStream {
    questions: Option<mpsc::Sender<v1::StreamLinesOfSightRequest>>,
    answers: Streaming<v1::StreamLinesOfSightResponse>,
}

impl LineStream {
    /// Asks a group of lines, each with an id of the caller's. Waits while the server has no room: read answers
    /// meanwhile, or from another task (see [`LineStream::split`]).
    pub async fn ask(&self, ids: Vec<u64>, lines: v1::QueryLineOfSightBatchRequest) -> Result<(), ClientError> {
        let questions = self.questions.as_ref().ok_or(ClientError::Closed)?;
        let group = v1::StreamLinesOfSightRequest { ids, lines: Some(lines) };
        questions.send(group).await.map_err(|_| ClientError::Closed)
    }

    /// Says that no more questions come; the answers to those asked still do.
    pub fn finish(&mut self) {
        self.questions = None;
    }

    /// The next answers, of whichever group is ready; `None` when all have come.
    pub async fn next(&mut self) -> Result<Option<v1::StreamLinesOfSightResponse>, ClientError> {
        Ok(self.answers.message().await?)
    }

    /// The two directions, for two tasks.
    pub fn split(
        self,
    ) -> (Option<mpsc::Sender<v1::StreamLinesOfSightRequest>>, Streaming<v1::StreamLinesOfSightResponse>) {
        (self.questions, self.answers)
    }
}

/// The tiles of a viewshed as they come. Dropping it stops the server's work.
#[derive(Debug)]
pub struct Tiles(Streaming<v1::QueryViewshedResponse>);

impl Tiles {
    /// The next tile; `None` after the last.
    pub async fn next(&mut self) -> Result<Option<v1::QueryViewshedResponse>, ClientError> {
        Ok(self.0.message().await?)
    }
}

impl Client {
    /// Opens a stream of questions.
    pub async fn stream_lines(&self) -> Result<LineStream, ClientError> {
        let (questions, asked) = mpsc::channel(WAITING_GROUPS);
        let answers = self.lines().stream_lines_of_sight(ReceiverStream::new(asked)).await?.into_inner();
        Ok(LineStream { questions: Some(questions), answers })
    }

    /// The first ground in a direction.
    pub async fn ray(&self, request: v1::QueryRayRequest) -> Result<v1::QueryRayResponse, ClientError> {
        Ok(self.lines().query_ray(request).await?.into_inner())
    }

    /// The horizon of an observer.
    pub async fn horizon(&self, request: v1::QueryHorizonRequest) -> Result<v1::QueryHorizonResponse, ClientError> {
        Ok(self.lines().query_horizon(request).await?.into_inner())
    }

    /// The ground under a line.
    pub async fn profile(&self, request: v1::QueryProfileRequest) -> Result<v1::QueryProfileResponse, ClientError> {
        Ok(self.lines().query_profile(request).await?.into_inner())
    }

    /// What an observer sees of a region.
    pub async fn viewshed(&self, request: v1::QueryViewshedRequest) -> Result<Tiles, ClientError> {
        Ok(Tiles(self.lines().query_viewshed(request).await?.into_inner()))
    }

    /// Which of many points see each other: for each point, the verdicts between it and those after it.
    pub async fn intervisibility(
        &self,
        request: v1::QueryIntervisibilityRequest,
    ) -> Result<Vec<Vec<v1::Verdict>>, ClientError> {
        let mut rows = self.lines().query_intervisibility(request).await?.into_inner();
        let mut matrix = Vec::new();
        while let Some(row) = rows.message().await? {
            if row.row as usize != matrix.len() {
                return Err(ClientError::Protocol("a row of a matrix that does not follow the one before"));
            }
            matrix.push(row.verdicts().collect());
        }
        Ok(matrix)
    }
}
