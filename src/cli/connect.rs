//! How the verbs that talk to a server reach it. What they trust and who they are stands in the environment, so that
//! every verb and every process that one starts has it alike.

use std::path::PathBuf;

use sightline_client::{Access, Client, ClientError};

use super::Failure;

/// File of the authorities that sign servers' certificates, PEM; for addresses with `https://`.
const AUTHORITIES: &str = "SIGHTLINE_AUTHORITIES";
/// File of this client's certificate, PEM, with [`KEY`].
const CERTIFICATE: &str = "SIGHTLINE_CERTIFICATE";
/// File of this client's key, PEM.
const KEY: &str = "SIGHTLINE_KEY";
/// File with the secret of this client's token.
const TOKEN: &str = "SIGHTLINE_TOKEN_FILE";

/// A connection to `address` as the environment says.
pub(super) async fn connect(address: &str) -> Result<Client, Failure> {
    let identity = match (file(CERTIFICATE)?, file(KEY)?) {
        (Some(certificate), Some(key)) => Some((certificate, key)),
        (None, None) => None,
        _ => return Err(Failure::Usage(format!("{CERTIFICATE} and {KEY} belong together"))),
    };
    let token = file(TOKEN)?.map(|secret| secret.trim_ascii().to_vec()).map(String::from_utf8).transpose();
    let token = token.map_err(|_| Failure::Input(format!("the file of {TOKEN} is not text")))?;
    let access = Access { authorities: file(AUTHORITIES)?, identity, token };
    Client::connect_with(address, &access).await.map_err(failure)
}

/// A failed call as the failure of a verb.
pub(super) fn failure(error: ClientError) -> Failure {
    match error {
        ClientError::Connect { .. } | ClientError::Closed => Failure::Environment(error.to_string()),
        _ => Failure::Input(error.to_string()),
    }
}

/// The content of the file that a variable names.
fn file(variable: &str) -> Result<Option<Vec<u8>>, Failure> {
    let Some(path) = std::env::var_os(variable).filter(|path| !path.is_empty()).map(PathBuf::from) else {
        return Ok(None);
    };
    let content = std::fs::read(&path);
    content.map(Some).map_err(|error| Failure::input(format!("{variable}: {}", path.display()), error))
}
