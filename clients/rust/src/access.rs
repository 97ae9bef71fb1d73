//! What a client trusts and who it is: certificates and a token. And what is wrong when they do not fit, in words.

use std::error::Error;

use tonic::{
    Request, Status,
    metadata::{Ascii, MetadataValue},
    service::Interceptor,
    transport::{Certificate, ClientTlsConfig, Identity},
};

use crate::ClientError;

/// What a client trusts and who it is.
#[derive(Clone, Default)]
pub struct Access {
    /// The authorities one of which must have signed the server's certificate, PEM; for `https://` only.
    pub authorities: Option<Vec<u8>>,
    /// This client's certificate and its key, PEM: for servers that ask for one.
    pub identity: Option<(Vec<u8>, Vec<u8>)>,
    /// The secret of this client's token.
    pub token: Option<String>,
}

impl std::fmt::Debug for Access {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Access")
    }
}

impl Access {
    pub(crate) fn tls(&self) -> ClientTlsConfig {
        let mut config = ClientTlsConfig::new();
        if let Some(authorities) = &self.authorities {
            config = config.ca_certificate(Certificate::from_pem(authorities));
        }
        if let Some((certificate, key)) = &self.identity {
            config = config.identity(Identity::from_pem(certificate, key));
        }
        config
    }
}

/// Adds the token to each call.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bearer(Option<MetadataValue<Ascii>>);

impl Bearer {
    pub(crate) fn new(token: Option<&str>) -> Result<Self, ClientError> {
        let value = |token: &str| {
            let mut value: MetadataValue<Ascii> = format!("Bearer {token}").parse().ok()?;
            value.set_sensitive(true);
            Some(value)
        };
        match token.map(value) {
            None => Ok(Self(None)),
            Some(Some(value)) => Ok(Self(Some(value))),
            Some(None) => Err(ClientError::Certificate("the token is not a line of ASCII characters".into())),
        }
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request.metadata_mut().insert("authorization", value.clone());
        }
        Ok(request)
    }
}

/// All that an error and its causes say.
fn chain(error: &dyn Error) -> String {
    let mut words = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let cause_words = cause.to_string();
        if !words.contains(&cause_words) {
            words = format!("{words}: {cause_words}");
        }
        next = cause.source();
    }
    words
}

/// What rustls says, and what it means to who runs the client.
const CERTIFICATE_TROUBLES: [(&str, &str); 6] = [
    ("CertificateRequired", "the server asks clients for a certificate (mutual TLS): give this client one and its key"),
    ("received fatal alert: CertificateExpired", "the server says that this client's certificate has expired"),
    ("received fatal alert: UnknownCA", "the server does not know the authority of this client's certificate"),
    ("UnknownIssuer", "the server's certificate is signed by no authority that this client was given"),
    ("Expired", "the server's certificate has expired"),
    ("NotValidForName", "the server's certificate is for another name than the address"),
];

fn trouble(words: &str) -> Option<&'static str> {
    let plain = |text: &str| text.replace(' ', "").to_ascii_lowercase();
    let said = plain(words);
    let meant = CERTIFICATE_TROUBLES.iter().find(|(sign, _)| said.contains(&plain(sign)));
    meant.map(|(_, meaning)| *meaning)
}

/// Why a connection failed.
pub(crate) fn reason(error: &dyn Error) -> String {
    let words = chain(error);
    trouble(&words).map_or(words.clone(), |meaning| format!("{meaning} ({words})"))
}

/// What a failed call has to do with certificates: with TLS 1.3 a server refuses a client's only after the connection
/// stands, and the first call then fails with the code UNKNOWN or UNAVAILABLE.
pub(crate) fn explain(status: &Status) -> Option<String> {
    status.source()?;
    let words = chain(status);
    trouble(&words).map(|meaning| format!("{meaning} ({words})"))
}
