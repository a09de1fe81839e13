//! The keys of a site: an authority, a certificate and a key for each host, and the token of its runs. They are made by
//! one command and read with their permissions checked. Not here: their use.

use metamorph_protocol::ids::HostId;
use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DnType, ExtendedKeyUsagePurpose, IsCa, KeyPair,
    KeyUsagePurpose, SanType, date_time_ymd,
};
use rustix::rand::{GetRandomFlags, getrandom};
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use std::fs::{self, DirBuilder, File};
use std::io::{self, Read, Write};
use std::net::IpAddr;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use thiserror::Error;
use x509_parser::prelude::{FromDer, X509Certificate};

const AUTHORITY: &str = "ca.pem";
const TOKEN: &str = "token";
/// Length of a token in bytes.
const TOKEN_SIZE: usize = 32;
/// Largest file of keys in bytes.
const LIMIT: u64 = 1 << 20;
/// Time before now from which certificates are valid, since clocks of machines differ.
const BEFORE: Duration = Duration::from_secs(3_600);

/// Why keys cannot be made or used.
#[derive(Debug, Error)]
pub enum KeysError {
    /// A file cannot be read.
    #[error(
        "{0}: {1}\n  fix: make keys with `metamorph host --keys DIR --make-keys hosts.toml`, and copy to each host its own"
    )]
    Read(PathBuf, io::Error),
    /// A file cannot be written.
    #[error("{0}: {1}\n  fix: name a directory that does not exist yet")]
    Write(PathBuf, io::Error),
    /// Others may read a secret.
    #[error("{0} may be read by others (mode {1:03o})\n  fix: chmod 600 {0}")]
    Open(PathBuf, u32),
    /// A file does not hold what it should.
    #[error("{0}: {1}\n  fix: make keys again with `metamorph host --make-keys`")]
    Content(PathBuf, &'static str),
    /// A certificate is that of another host.
    #[error("{0} is the certificate of `{1}`\n  fix: copy {2}.pem and {2}.key of one `--make-keys` to {2}")]
    Foreign(PathBuf, String, HostId),
    /// A certificate cannot be made.
    #[error("the certificate of {0} cannot be made: {1}")]
    Make(String, rcgen::Error),
}

/// The keys of one host.
#[derive(Clone)]
pub struct Keys {
    /// The host.
    pub host: HostId,
    /// The file of the authority's certificate.
    pub authority: PathBuf,
    /// The file of the host's certificate.
    pub certificate: PathBuf,
    /// The file of its key.
    pub key: PathBuf,
    /// The token of the site's runs.
    pub token: [u8; TOKEN_SIZE],
}

impl Keys {
    /// Reads the keys of a host.
    ///
    /// # Errors
    /// If a file is missing or may be read by others.
    pub fn read(directory: &Path, host: HostId) -> Result<Keys, KeysError> {
        // zenoh and the TLS handshake take absolute paths only.
        let unreadable = |e| KeysError::Read(directory.to_owned(), e);
        let directory = std::path::absolute(directory).map_err(unreadable)?;
        let file = |name: String| directory.join(name);
        let keys = Keys {
            host,
            authority: file(AUTHORITY.into()),
            certificate: file(format!("{host}.pem")),
            key: file(format!("{host}.key")),
            token: [0; TOKEN_SIZE],
        };
        read(&keys.authority)?;
        let certificate = read(&keys.certificate)?;
        let named = name(&certificate).ok_or_else(|| {
            KeysError::Content(keys.certificate.clone(), "it holds no certificate of a host")
        })?;
        if named != host.to_string() {
            return Err(KeysError::Foreign(keys.certificate.clone(), named, host));
        }
        secret(&keys.key)?;
        let path = file(TOKEN.into());
        let token = secret(&path)?;
        let token = token.try_into().map_err(|_| KeysError::Content(path, "a token is 32 bytes long"))?;
        Ok(Keys { token, ..keys })
    }
}

/// Returns the name of the host in a certificate in PEM form.
fn name(pem: &[u8]) -> Option<String> {
    let certificate = CertificateDer::from_pem_slice(pem).ok()?;
    common_name(&certificate)
}

/// Returns the name in a certificate.
pub fn common_name(certificate: &CertificateDer<'_>) -> Option<String> {
    let (_, certificate) = X509Certificate::from_der(certificate).ok()?;
    let name = certificate.subject().iter_common_name().next()?.as_str().ok()?;
    Some(name.to_owned())
}

fn read(path: &Path) -> Result<Vec<u8>, KeysError> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(LIMIT).read_to_end(&mut bytes));
    read.map_err(|e| KeysError::Read(path.to_owned(), e))?;
    Ok(bytes)
}

/// Reads a file, and refuses one that other users can read.
fn secret(path: &Path) -> Result<Vec<u8>, KeysError> {
    let bytes = read(path)?;
    let mode = fs::metadata(path).map_err(|e| KeysError::Read(path.to_owned(), e))?.permissions().mode();
    if mode & 0o077 != 0 {
        return Err(KeysError::Open(path.to_owned(), mode & 0o777));
    }
    Ok(bytes)
}

/// Makes an authority, and the keys of these hosts with the machines under which they are reached, in a new directory.
/// The authority's own key is not kept, so no certificate can be added later.
///
/// # Errors
/// If the directory exists, or a file cannot be written.
pub fn make(directory: &Path, hosts: &[(HostId, Vec<String>)], valid: Duration) -> Result<(), KeysError> {
    let unwritable = |e| KeysError::Write(directory.to_owned(), e);
    DirBuilder::new().mode(0o700).create(directory).map_err(unwritable)?;
    let failed = |e| KeysError::Make("the authority".into(), e);
    let mut params = dated(CertificateParams::default(), valid);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params.distinguished_name.push(DnType::CommonName, "metamorph hosts");
    let key = KeyPair::generate().map_err(failed)?;
    let authority = CertifiedIssuer::self_signed(params, key).map_err(failed)?;
    write(&directory.join(AUTHORITY), authority.pem().as_bytes(), 0o644)?;
    for (host, machines) in hosts {
        let failed = |e| KeysError::Make(host.to_string(), e);
        let mut params = dated(CertificateParams::default(), valid);
        params.distinguished_name.push(DnType::CommonName, host.to_string());
        params.subject_alt_names = names(*host, machines).map_err(failed)?;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages =
            vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        params.use_authority_key_identifier_extension = true;
        let key = KeyPair::generate().map_err(failed)?;
        let certificate = params.signed_by(&key, &authority).map_err(failed)?;
        write(&directory.join(format!("{host}.pem")), certificate.pem().as_bytes(), 0o644)?;
        write(&directory.join(format!("{host}.key")), key.serialize_pem().as_bytes(), 0o600)?;
    }
    let mut token = [0; TOKEN_SIZE];
    getrandom(&mut token[..], GetRandomFlags::empty()).map_err(|e| unwritable(e.into()))?;
    write(&directory.join(TOKEN), &token, 0o600)
}

fn names(host: HostId, machines: &[String]) -> Result<Vec<SanType>, rcgen::Error> {
    let name = |text: &str| -> Result<SanType, rcgen::Error> {
        match text.parse::<IpAddr>() {
            Ok(address) => Ok(SanType::IpAddress(address)),
            Err(_) => Ok(SanType::DnsName(text.try_into()?)),
        }
    };
    machines.iter().map(|machine| name(machine)).chain([name(&host.to_string())]).collect()
}

#[allow(clippy::disallowed_methods, reason = "certificates have dates; no run depends on them")]
fn dated(mut params: CertificateParams, valid: Duration) -> CertificateParams {
    let now = date_time_ymd(1970, 1, 1) + SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    (params.not_before, params.not_after) = (now - BEFORE, now + valid);
    params
}

fn write(path: &Path, bytes: &[u8], mode: u32) -> Result<(), KeysError> {
    let file = File::options().write(true).create_new(true).mode(mode).open(path);
    file.and_then(|mut file| file.write_all(bytes)).map_err(|e| KeysError::Write(path.to_owned(), e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_private_and_read_back() {
        let directory = tempfile::tempdir().unwrap();
        let keys = directory.path().join("keys");
        let hosts = [(HostId(0), vec![]), (HostId(1), vec!["127.0.0.1".to_owned(), "rack".to_owned()])];
        make(&keys, &hosts, Duration::from_secs(60)).unwrap();
        assert_eq!(fs::metadata(&keys).unwrap().permissions().mode() & 0o777, 0o700);
        let (h1, h2) = (Keys::read(&keys, HostId(0)).unwrap(), Keys::read(&keys, HostId(1)).unwrap());
        assert!(h1.token == h2.token && h1.token != [0; 32] && h1.key != h2.key);
        assert!(matches!(Keys::read(&keys, HostId(2)), Err(KeysError::Read(..))));
        // Keys are never overwritten.
        assert!(matches!(make(&keys, &hosts, Duration::from_secs(60)), Err(KeysError::Write(..))));
        fs::set_permissions(&h2.key, fs::Permissions::from_mode(0o640)).unwrap();
        let error = Keys::read(&keys, HostId(1)).err().unwrap().to_string();
        assert!(error.contains("mode 640") && error.contains("chmod 600"), "{error}");
        // The keys of one host under the name of another are named.
        let as_h1 = ["pem", "key"]
            .map(|kind| fs::copy(keys.join(format!("h2.{kind}")), keys.join(format!("h1.{kind}"))));
        assert!(as_h1.iter().all(Result::is_ok));
        let error = Keys::read(&keys, HostId(0)).err().unwrap().to_string();
        assert!(error.contains("is the certificate of `h2`") && error.contains("to h1"), "{error}");
        fs::set_permissions(&h2.key, fs::Permissions::from_mode(0o600)).unwrap();
        fs::write(keys.join(TOKEN), b"short").unwrap();
        assert!(matches!(Keys::read(&keys, HostId(1)), Err(KeysError::Content(..))));
    }
}
