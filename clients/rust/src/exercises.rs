//! Leases and watches of exercises.
//!
//! ```no_run
//! use sightline_client::{Client, v1};
//!
//! # async fn host(client: Client) -> Result<(), sightline_client::ClientError> {
//! // Goes 30 s after this process has vanished; until then the watch keeps it.
//! client.create_exercise_under("training", v1::Lease { owner: "host".into(), term_s: 30 }).await?;
//! let request = v1::WatchExerciseRequest { name: "training".into(), lease_owner: "host".into(), ..Default::default() };
//! let mut watch = client.watch_exercise(request).await?;
//! while let Some(news) = watch.next().await? {
//!     for line in news.changed {
//!         println!("line {} is {} at epoch {}", line.id, line.verdict().as_str_name(), news.epoch);
//!     }
//! }
//! # Ok(())
//! # }
//! ```

use tonic::Streaming;

use crate::{Client, ClientError, v1};

/// The verdicts of an exercise as they change. Dropping it ends the watch.
#[derive(Debug)]
pub struct ExerciseWatch {
    stream: Streaming<v1::WatchExerciseResponse>,
}

impl ExerciseWatch {
    /// What is new: at first the verdicts of all lines that are watched. `None`: the server has ended the watch without a
    /// reason. Cancelling it loses nothing.
    ///
    /// Errors: the exercise has ended (NOT_FOUND), or the connection.
    pub async fn next(&mut self) -> Result<Option<v1::WatchExerciseResponse>, ClientError> {
        Ok(self.stream.message().await?)
    }
}

impl Client {
    /// Makes an exercise that goes when the lease has run out.
    pub async fn create_exercise_under(&self, name: &str, lease: v1::Lease) -> Result<(), ClientError> {
        let request = v1::CreateExerciseRequest { name: name.to_owned(), lease: Some(lease) };
        self.exercises().create_exercise(request).await?;
        Ok(())
    }

    /// Gives the lease of `owner` in an exercise its full term again, in seconds. NOT_FOUND: it has run out, or there is
    /// nothing under it.
    pub async fn renew_lease(&self, name: &str, owner: &str) -> Result<u32, ClientError> {
        let request = v1::RenewLeaseRequest { name: name.to_owned(), owner: owner.to_owned() };
        Ok(self.exercises().renew_lease(request).await?.into_inner().term_s)
    }

    /// Watches the verdicts of an exercise.
    pub async fn watch_exercise(&self, request: v1::WatchExerciseRequest) -> Result<ExerciseWatch, ClientError> {
        let stream = self.exercises().watch_exercise(request).await?.into_inner();
        Ok(ExerciseWatch { stream })
    }
}
