//! Mutual TLS 1.3: both ends show a certificate, and trust those that an authority of theirs has signed.

use anyhow::Result;
use rustls::crypto::{CryptoProvider, ring};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use rustls::server::WebPkiClientVerifier;
use rustls::version::TLS13;
use rustls::{ClientConfig, ClientConnection, RootCertStore, ServerConfig};
use schemas::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// PEM files of an end.
#[derive(Clone, Debug)]
pub struct TlsFiles {
    /// this end's certificate, and those between it and its authority
    pub cert: PathBuf,
    /// its private key
    pub key: PathBuf,
    /// the authorities whose certificates the other end may have
    pub ca: PathBuf,
}

/// The sending end's TLS: whom it trusts, and who it expects.
pub struct Client {
    config: Arc<ClientConfig>,
    name: ServerName<'static>,
}

impl Client {
    /// A connection before its handshake.
    ///
    /// # Errors
    /// What the library refuses.
    pub(super) fn begin(&self) -> Result<rustls::Connection> {
        Ok(ClientConnection::new(self.config.clone(), self.name.clone())?.into())
    }
}

fn bad(file: &Path, place: &str, found: impl std::fmt::Display, allowed: &str) -> anyhow::Error {
    Error::bad(file.display().to_string(), place, found, allowed).into()
}

fn certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>> {
    let bytes = std::fs::read(file).map_err(|e| Error::io(file, "cannot be read", e))?;
    let allowed = "one or more certificates in PEM";
    let all: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&bytes).collect();
    match all {
        Ok(v) if v.is_empty() => Err(bad(file, "certificates", "none", allowed)),
        Ok(v) => Ok(v),
        Err(e) => Err(bad(file, "certificates", e, allowed)),
    }
}

fn private_key(file: &Path) -> Result<PrivateKeyDer<'static>> {
    let bytes = std::fs::read(file).map_err(|e| Error::io(file, "cannot be read", e))?;
    PrivateKeyDer::from_pem_slice(&bytes).map_err(|e| bad(file, "private key", e, "a private key in PEM"))
}

fn authorities(file: &Path) -> Result<Arc<RootCertStore>> {
    let mut roots = RootCertStore::empty();
    for c in certificates(file)? {
        let allowed = "certificates of authorities";
        roots.add(c).map_err(|e| bad(file, "certificates", e, allowed))?;
    }
    Ok(Arc::new(roots))
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}

/// TLS of a sending end.
///
/// * `name` that the receiving end's certificate must have: DNS name or IP address
///
/// # Errors
/// Files that are not what they should be.
pub fn client(files: &TlsFiles, name: &str) -> Result<Client> {
    let allowed = "a DNS name or an IP address";
    let server_name = ServerName::try_from(name.to_string());
    let name = server_name.map_err(|e| Error::bad("command line", "--tls-name", format!("{name} ({e})"), allowed))?;
    let config = ClientConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&TLS13])?
        .with_root_certificates(authorities(&files.ca)?)
        .with_client_auth_cert(certificates(&files.cert)?, private_key(&files.key)?)
        .map_err(|e| bad(&files.key, "private key", e, "the key of --tls-cert"))?;
    let config = Arc::new(config);
    Ok(Client { config, name })
}

/// TLS of a receiving end.
///
/// # Errors
/// As [`client`].
pub fn server(files: &TlsFiles) -> Result<ServerConfig> {
    let verifier = WebPkiClientVerifier::builder_with_provider(authorities(&files.ca)?, provider())
        .build()
        .map_err(|e| bad(&files.ca, "certificates", e, "certificates of authorities"))?;
    ServerConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&TLS13])?
        .with_client_cert_verifier(verifier)
        .with_single_cert(certificates(&files.cert)?, private_key(&files.key)?)
        .map_err(|e| bad(&files.key, "private key", e, "the key of --tls-cert"))
}
