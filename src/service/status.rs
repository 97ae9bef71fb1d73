//! Errors as gRPC statuses: the only place that knows the codes.
//!
//! INVALID_ARGUMENT: the request makes no sense on any server. NOT_FOUND: what it names does not exist. ALREADY_EXISTS:
//! what it makes does. FAILED_PRECONDITION: something else must be done before. RESOURCE_EXHAUSTED: a limit, named with
//! its value. ABORTED: someone else was faster, try again. DATA_LOSS: the database is damaged. UNAVAILABLE: it cannot be
//! read now, or the server is stopping.

use tonic::Status;

use crate::{
    exercise::{ChangeError, NameError, PlaceError},
    los::LosError,
    roam::MeshError,
    session::{EventError, FrameError, OpenError, SettingsError},
    store::StoreError,
    terrain::ReadError,
};

/// An error that knows its status.
pub(super) trait IntoStatus {
    fn into_status(self) -> Status;
}

impl IntoStatus for ReadError {
    fn into_status(self) -> Status {
        match self {
            Self::Damaged { .. } => Status::data_loss(self.to_string()),
            Self::Io { .. } => Status::unavailable(self.to_string()),
        }
    }
}

impl IntoStatus for LosError {
    fn into_status(self) -> Status {
        match self {
            Self::Read(error) => error.into_status(),
            Self::NotFinite { .. }
            | Self::OutOfRange { .. }
            | Self::OutOfBounds { .. }
            | Self::TooManyBreaks { .. }
            | Self::BadTolerance(_) => Status::invalid_argument(self.to_string()),
        }
    }
}

impl IntoStatus for PlaceError {
    fn into_status(self) -> Status {
        match self {
            Self::Ground(error) => error.into_status(),
            Self::NotFinite(_) | Self::BeyondProjection(_) => Status::invalid_argument(self.to_string()),
            Self::NoGeoreference | Self::NotGeographic => Status::failed_precondition(self.to_string()),
        }
    }
}

impl IntoStatus for NameError {
    fn into_status(self) -> Status {
        Status::invalid_argument(self.to_string())
    }
}

impl IntoStatus for StoreError {
    fn into_status(self) -> Status {
        let text = self.to_string();
        match self {
            Self::Exists(_) => Status::already_exists(text),
            Self::NotFound(_) => Status::not_found(text),
            Self::Conflict(_) => Status::aborted(text),
            Self::Full => Status::resource_exhausted(text),
            Self::Failed(_) => Status::unavailable(text),
        }
    }
}

impl IntoStatus for ChangeError {
    fn into_status(self) -> Status {
        let text = self.to_string();
        let code = match self {
            Self::Place { error, .. } => error.into_status().code(),
            Self::Verdict { error, .. } => error.into_status().code(),
            Self::Missing { .. } | Self::UnknownEntity { .. } => tonic::Code::NotFound,
            Self::Duplicate { .. } | Self::ReservedId => tonic::Code::InvalidArgument,
            Self::Anchoring { .. } => tonic::Code::FailedPrecondition,
            Self::Limit { .. } => tonic::Code::ResourceExhausted,
        };
        Status::new(code, text)
    }
}

impl IntoStatus for SettingsError {
    fn into_status(self) -> Status {
        Status::invalid_argument(self.to_string())
    }
}

impl IntoStatus for EventError {
    fn into_status(self) -> Status {
        Status::invalid_argument(self.to_string())
    }
}

impl IntoStatus for MeshError {
    fn into_status(self) -> Status {
        match self {
            Self::Read(error) => error.into_status(),
            other => Status::invalid_argument(other.to_string()),
        }
    }
}

impl IntoStatus for OpenError {
    fn into_status(self) -> Status {
        match self {
            Self::Settings(error) => error.into_status(),
            Self::Read(error) => error.into_status(),
            Self::Terrain(_) => Status::failed_precondition(self.to_string()),
        }
    }
}

impl IntoStatus for FrameError {
    fn into_status(self) -> Status {
        match self {
            Self::Mesh(error) => error.into_status(),
            Self::Eye(error) => error.into_status(),
            Self::Height { .. } => Status::failed_precondition(self.to_string()),
            Self::Replica(_) => Status::internal(self.to_string()),
        }
    }
}

/// Columns of a request that are not equally long.
pub(super) fn unequal(what: &str, lengths: &[usize]) -> Status {
    Status::invalid_argument(format!("the columns {what} must be equally long; they have {lengths:?} entries"))
}

/// More than a limit.
pub(super) fn too_many(what: &str, found: usize, limit: usize) -> Status {
    Status::resource_exhausted(format!("{found} {what}: the limit is {limit}"))
}
