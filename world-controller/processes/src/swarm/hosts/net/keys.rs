//! The keys of a site: an authority, a certificate and a key for each host, and the token of its runs. They are made by
//! one command and read with their permissions checked. Not here: their use.

use metamorph_protocol::ids::HostId;
use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer,
    KeyPair, KeyUsagePurpose, SanType, SigningKey, date_time_ymd,
};
use rustix::rand::{GetRandomFlags, getrandom};
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use std::collections::BTreeSet;
use std::fs::{self, DirBuilder, File};
use std::io::{self, Read, Write};
use std::net::IpAddr;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use thiserror::Error;
use x509_parser::prelude::{FromDer, GeneralName, X509Certificate};

const AUTHORITY: &str = "ca.pem";
/// Time for which an authority is valid, at least.
const AUTHORITY_VALID: Duration = Duration::from_secs(3_650 * 86_400);
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
    /// The key of the authority is not there.
    #[error(
        "{0} is missing, and without the key of the authority no certificate can be made\n  fix: use the directory in which the keys were made, or make new keys for all hosts"
    )]
    NoAuthority(PathBuf),
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

/// Makes an authority, and the keys of these hosts with the machines under which they are reached, in a new directory. The
/// authority's own key is in a file beside it, readable by its owner only, so that [`renew`] can make further certificates; no host needs it.
///
/// # Errors
/// If the directory exists, or a file cannot be written.
pub fn make(directory: &Path, hosts: &[(HostId, Vec<String>)], valid: Duration) -> Result<(), KeysError> {
    let unwritable = |e| KeysError::Write(directory.to_owned(), e);
    DirBuilder::new().mode(0o700).create(directory).map_err(unwritable)?;
    let failed = |e| KeysError::Make("the authority".into(), e);
    let mut params = dated(CertificateParams::default(), AUTHORITY_VALID.max(valid));
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params.distinguished_name.push(DnType::CommonName, "metamorph hosts");
    let key = KeyPair::generate().map_err(failed)?;
    let key_pem = key.serialize_pem();
    let authority = CertifiedIssuer::self_signed(params, key).map_err(failed)?;
    write(&directory.join(AUTHORITY), authority.pem().as_bytes(), 0o644)?;
    write(&authority_key(directory), key_pem.as_bytes(), 0o600)?;
    for (host, machines) in hosts {
        issue(directory, &authority, *host, machines, valid)?;
    }
    let mut token = [0; TOKEN_SIZE];
    getrandom(&mut token[..], GetRandomFlags::empty()).map_err(|e| unwritable(e.into()))?;
    write(&directory.join(TOKEN), &token, 0o600)
}

/// Makes certificates and keys for hosts that have none yet, whose machines have changed, or whose certificates are valid for less
/// than a third of `valid`. Authority and token stay, so other hosts need nothing new. Returns the hosts.
///
/// # Errors
/// If the key of the authority is not there, or a file cannot be written.
pub fn renew(
    directory: &Path,
    hosts: &[(HostId, Vec<String>)],
    valid: Duration,
) -> Result<Vec<HostId>, KeysError> {
    let is_fit = |host: HostId, machines: &[String]| {
        let certificate = fs::read(directory.join(format!("{host}.pem"))).ok();
        certificate.is_some_and(|pem| fits(&pem, host, machines, valid / 3) == Some(true))
    };
    let due: Vec<_> = hosts.iter().filter(|(host, machines)| !is_fit(*host, machines)).collect();
    if due.is_empty() {
        return Ok(Vec::new());
    }
    let failed = |e| KeysError::Make("the authority".into(), e);
    let text = |path: PathBuf, bytes: Vec<u8>| {
        String::from_utf8(bytes).map_err(|_| KeysError::Content(path, "it is not in PEM form"))
    };
    let key_path = authority_key(directory);
    if !key_path.exists() {
        return Err(KeysError::NoAuthority(key_path));
    }
    let key = text(key_path.clone(), secret(&key_path)?)?;
    let path = directory.join(AUTHORITY);
    let pem = text(path.clone(), read(&path)?)?;
    let authority =
        Issuer::from_ca_cert_pem(&pem, KeyPair::from_pem(&key).map_err(failed)?).map_err(failed)?;
    for (host, machines) in &due {
        issue(directory, &authority, *host, machines, valid)?;
    }
    Ok(due.into_iter().map(|(host, _)| *host).collect())
}

/// Returns where the key of the authority is: beside the directory of the keys, which is copied and mounted as a whole at times.
fn authority_key(directory: &Path) -> PathBuf {
    let mut name = directory.file_name().unwrap_or_default().to_owned();
    name.push(".ca.key");
    directory.with_file_name(name)
}

/// Makes the certificate and the key of a host, in place of those before.
fn issue(
    directory: &Path,
    authority: &Issuer<'_, impl SigningKey>,
    host: HostId,
    machines: &[String],
    valid: Duration,
) -> Result<(), KeysError> {
    let failed = |e| KeysError::Make(host.to_string(), e);
    let mut params = dated(CertificateParams::default(), valid);
    params.distinguished_name.push(DnType::CommonName, host.to_string());
    params.subject_alt_names = names(host, machines).map_err(failed)?;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages =
        vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
    params.use_authority_key_identifier_extension = true;
    let key = KeyPair::generate().map_err(failed)?;
    let certificate = params.signed_by(&key, authority).map_err(failed)?;
    let files = [("pem", certificate.pem(), 0o644), ("key", key.serialize_pem(), 0o600)];
    for (kind, text, mode) in files {
        let (path, part) =
            (directory.join(format!("{host}.{kind}")), directory.join(format!("{host}.{kind}.part")));
        let _ = fs::remove_file(&part);
        write(&part, text.as_bytes(), mode)?;
        fs::rename(&part, &path).map_err(|e| KeysError::Write(path, e))?;
    }
    Ok(())
}

/// Returns whether a certificate is that of the host at these machines and is valid for so long; `None` if it cannot be read.
#[allow(clippy::disallowed_methods, reason = "certificates have dates; no run depends on them")]
fn fits(pem: &[u8], host: HostId, machines: &[String], left: Duration) -> Option<bool> {
    let certificate = CertificateDer::from_pem_slice(pem).ok()?;
    let (_, parsed) = X509Certificate::from_der(&certificate).ok()?;
    let named = parsed.subject_alternative_name().ok()??;
    let named: BTreeSet<String> = named
        .value
        .general_names
        .iter()
        .filter_map(|name| match name {
            GeneralName::DNSName(name) => Some((*name).to_owned()),
            GeneralName::IPAddress(bytes) => match bytes.len() {
                4 => Some(IpAddr::from(<[u8; 4]>::try_from(*bytes).ok()?).to_string()),
                _ => Some(IpAddr::from(<[u8; 16]>::try_from(*bytes).ok()?).to_string()),
            },
            _ => None,
        })
        .collect();
    let wanted = machines.iter().cloned().chain([host.to_string()]).collect();
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let until = u64::try_from(parsed.validity().not_after.timestamp()).unwrap_or(0);
    Some(named == wanted && Duration::from_secs(until) >= now + left)
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

    #[test]
    fn only_what_is_due_is_renewed() {
        let directory = tempfile::tempdir().unwrap();
        let keys = directory.path().join("keys");
        let host = |number, machine: &str| (HostId(number), vec![machine.to_owned()]);
        let mut hosts = vec![host(1, "10.0.0.2"), host(2, "rack3")];
        let (day, month) = (Duration::from_secs(86_400), Duration::from_secs(30 * 86_400));
        make(&keys, &hosts, month).unwrap();
        let token = fs::read(keys.join(TOKEN)).unwrap();
        assert_eq!(renew(&keys, &hosts, month).unwrap(), []);
        // A host that is new, one that has moved, and certificates that end too soon.
        hosts.push(host(3, "::1"));
        assert_eq!(renew(&keys, &hosts, month).unwrap(), [HostId(3)]);
        hosts[0] = host(1, "10.0.0.9");
        assert_eq!(renew(&keys, &hosts, month).unwrap(), [HostId(1)]);
        assert_eq!(renew(&keys, &hosts, day).unwrap(), []);
        assert_eq!(renew(&keys, &hosts, month * 4).unwrap().len(), 3);
        assert_eq!(fs::read(keys.join(TOKEN)).unwrap(), token);
        assert_eq!(fs::metadata(authority_key(&keys)).unwrap().permissions().mode() & 0o777, 0o600);
        Keys::read(&keys, HostId(3)).unwrap();
        fs::remove_file(authority_key(&keys)).unwrap();
        hosts.push(host(4, "rack5"));
        let error = renew(&keys, &hosts, month).unwrap_err().to_string();
        assert!(error.contains("keys.ca.key is missing") && error.contains("fix: "), "{error}");
    }
}
