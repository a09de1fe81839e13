//! Output files: which ones a command may write, and how.
//!
//! A command registers its input files with [`Outputs`] and requests each output file from it. A file that is
//! also read, or written twice, is refused, even under another name: files are compared by device and inode,
//! and files that do not exist yet by their directory and name. Output appears at the end and as a whole: it
//! is written to an unnamed file in the same directory, which is linked to the name when complete. So an
//! existing file is never half overwritten, and nothing is left behind however the program ends. Devices,
//! pipes and descriptors (`/dev/stdout`) are written directly. A file that is a mount point, as in a container, cannot be
//! replaced: it is overwritten when the content is complete.
//!
//! An existing file is replaced only if this program wrote it with the same [`OutputKind`]. A symbolic link of another user in a directory
//! that all may write to is not followed, as the kernel does with `protected_symlinks`.
//!
//! Absent: result directories (see `experiments::sweep::store`), and journals of active runs, which are
//! written piece by piece so that they survive a killed run.

use crate::output_kind::OutputKind;
use crate::terminal::print_data;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_text::escape::{Shown, json};
use rustix::fs::{AtFlags, CWD, Mode, OFlags, StatxAttributes, StatxFlags, fcntl_setfl, statx};
use rustix::io::Errno;
use serde::Serialize;
use std::ffi::OsString;
use std::fs::{self, File, Metadata, OpenOptions, Permissions};
use std::io::{self, Seek, Write};
use std::os::fd::{AsFd, AsRawFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use tempfile::{Builder, TempPath};
use thiserror::Error;

/// Largest number of symbolic links followed from one path.
const MAX_LINKS: usize = 40;

/// Why a file cannot be written.
#[derive(Debug, Error)]
pub enum OutputError {
    /// The file is already used for something else.
    #[error("{name}: this is the same file as {other}\n  fix: name another file")]
    Same {
        /// The option that names the file, and the file's name.
        name: String,
        /// The other use of the file.
        other: String,
    },
    /// The file is not one that this program wrote with the same kind.
    #[error(
        "{name}: there is a file that is not {kind} of this program\n  fix: name another file, or replace it with --force"
    )]
    Stranger {
        /// The option that names the file, and the file's name.
        name: String,
        /// The kind of the output.
        kind: &'static str,
    },
    /// The destination is not writable.
    #[error("{name}: cannot write there: {}\n  fix: {fix}", reason(.error))]
    Unwritable {
        /// The option that names the file, and the file's name.
        name: String,
        /// The cause.
        error: io::Error,
        /// Suggested fix.
        fix: &'static str,
    },
    /// Writing or renaming failed.
    #[error("{name}: cannot write: {error}; the previous content is unchanged")]
    Write {
        /// The option that names the file, and the file's name.
        name: String,
        /// The cause.
        error: io::Error,
    },
}

impl OutputError {
    /// Returns true if the command line is at fault, not the disk.
    pub fn is_input(&self) -> bool {
        !matches!(self, OutputError::Write { .. })
    }
}

impl CommandError for OutputError {
    fn exit_code(&self) -> u8 {
        if self.is_input() { BAD_USAGE } else { FAILED }
    }
}

/// Identity of a file. Two names with equal identities are the same file.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Identity {
    /// An existing file: device and inode.
    There(u64, u64),
    /// A file yet to be created: device and inode of its directory, and its name.
    Not(u64, u64, OsString),
}

impl Identity {
    fn of(file: &Metadata) -> Identity {
        Identity::There(file.dev(), file.ino())
    }
}

/// The files that a command reads and writes.
#[derive(Debug, Default)]
pub struct Outputs {
    taken: Vec<(Identity, String)>,
}

impl Outputs {
    /// Returns the registry of a command that writes to standard output and reads nothing yet.
    pub fn new() -> Outputs {
        let out = io::stdout().as_fd().try_clone_to_owned().map(File::from);
        let mut outputs = Outputs::default();
        if let Some(out) = out.and_then(|out| out.metadata()).ok().filter(Metadata::is_file) {
            outputs.taken.push((Identity::of(&out), "standard output".to_owned()));
        }
        outputs
    }

    /// Registers an input file. Special files are not registered: they cannot be overwritten by mistake.
    pub fn reads(&mut self, what: &str, path: &Path) {
        if let Some(file) = fs::metadata(path).ok().filter(Metadata::is_file) {
            self.taken.push((Identity::of(&file), format!("{what} {}", path.shown())));
        }
    }

    /// Registers all files of an input directory.
    pub fn reads_directory(&mut self, what: &str, path: &Path) {
        for entry in fs::read_dir(path).into_iter().flatten().flatten() {
            self.reads(what, &entry.path());
        }
    }

    /// Registers an output file that may exist; `option` is the option that names it. Checks now, not after a
    /// long run, that it can be written. An existing file is kept until the end.
    ///
    /// # Errors
    ///
    /// There is a file that this program did not write with this kind, the file cannot be written, or it is used for something
    /// else.
    pub fn writes(&mut self, option: &str, path: &Path, kind: OutputKind) -> Result<Output, OutputError> {
        self.output(option, path, Before::Any(kind))
    }

    /// Registers an output file that must not exist yet.
    ///
    /// # Errors
    ///
    /// The file exists, its directory is not writable, or it is used for something else.
    pub fn creates(&mut self, option: &str, path: &Path) -> Result<Output, OutputError> {
        self.output(option, path, Before::Nothing)
    }

    fn output(&mut self, option: &str, path: &Path, before: Before) -> Result<Output, OutputError> {
        let name = format!("{option} {}", path.shown());
        let fix = match before {
            Before::Any(_) if option == "--json" => {
                "name a file in a directory that exists and is yours, or `-` for standard output"
            }
            Before::Any(_) => "name a file in a directory that exists and is yours",
            Before::Nothing => "name a new file in a directory that exists and is yours",
        };
        let wrong = |error| OutputError::Unwritable { name: name.clone(), error, fix };
        let target = Target::of(path).map_err(wrong)?;
        if let Some(identity) = target.identity().map_err(wrong)? {
            if let Some((_, other)) = self.taken.iter().find(|(taken, _)| *taken == identity) {
                return Err(OutputError::Same { name, other: other.clone() });
            }
            self.taken.push((identity, name.clone()));
        }
        if let (Before::Any(kind), Target::File(file) | Target::Mounted(file)) = (before, &target)
            && file.exists()
            && !kind.may_replace(file).map_err(wrong)?
        {
            return Err(OutputError::Stranger { name, kind: kind.name() });
        }
        target.check(before).map_err(wrong)?;
        Ok(Output { name, target, before })
    }
}

/// Expected state of the destination before a file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Before {
    Any(OutputKind),
    Nothing,
}

/// A file that a command may write.
#[derive(Debug)]
pub struct Output {
    name: String,
    target: Target,
    before: Before,
}

impl Output {
    /// Writes the whole file.
    pub fn write(&self, content: impl AsRef<[u8]>) -> Result<(), OutputError> {
        let draft = self.begin()?;
        draft.handle().and_then(|mut file| file.write_all(content.as_ref())).map_err(|e| self.failed(e))?;
        self.finish(draft)
    }

    /// Creates the unnamed file that will become the output.
    pub fn begin(&self) -> Result<PendingOutput, OutputError> {
        PendingOutput::of(&self.target).map_err(|error| self.failed(error))
    }

    /// Gives the complete file its name.
    pub fn finish(&self, draft: PendingOutput) -> Result<(), OutputError> {
        draft.finish(&self.target, self.before).map_err(|error| self.failed(error))
    }

    fn failed(&self, error: io::Error) -> OutputError {
        OutputError::Write { name: self.name.clone(), error }
    }
}

/// The destination of an output.
#[derive(Debug)]
enum Target {
    /// A stream, written directly. It is kept open, because the reader of a pipe would take closing for the
    /// end.
    Stream(File),
    /// A regular file, existing or not, at a path that is not a symbolic link.
    File(PathBuf),
    /// An existing file that is a mount point, so that no other file can take its place.
    Mounted(PathBuf),
}

impl Target {
    fn of(path: &Path) -> io::Result<Target> {
        let place = match place(path)? {
            Place::Descriptor(path) => return stream(&path).map(Target::Stream),
            Place::File(path) => path,
        };
        match fs::symlink_metadata(&place).map(|file| file.file_type()) {
            Ok(kind) if kind.is_file() && is_mount_point(&place) => Ok(Target::Mounted(place)),
            Ok(kind) if kind.is_file() => Ok(Target::File(place)),
            Ok(kind) if kind.is_dir() => Err(Errno::ISDIR.into()),
            Ok(kind) if kind.is_socket() => Err(io::Error::other("it is a socket")),
            Ok(_) => stream(&place).map(Target::Stream),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Target::File(place)),
            Err(error) => Err(error),
        }
    }

    fn identity(&self) -> io::Result<Option<Identity>> {
        let (Target::File(path) | Target::Mounted(path)) = self else { return Ok(None) };
        if let Ok(file) = fs::symlink_metadata(path) {
            return Ok(Some(Identity::of(&file)));
        }
        let directory = fs::metadata(directory(path))?;
        let name = path.file_name().unwrap_or_default().to_owned();
        Ok(Some(Identity::Not(directory.dev(), directory.ino(), name)))
    }

    /// Checks that the destination can be written; changes nothing.
    fn check(&self, before: Before) -> io::Result<()> {
        let (Target::File(path) | Target::Mounted(path)) = self else {
            return match before {
                Before::Any(_) => Ok(()),
                Before::Nothing => Err(Errno::EXIST.into()),
            };
        };
        match (fs::symlink_metadata(path), before) {
            (Ok(_), Before::Nothing) => return Err(Errno::EXIST.into()),
            // Renaming would also replace a file without write permission.
            (Ok(_), Before::Any(_)) => drop(OpenOptions::new().append(true).open(path)?),
            (Err(_), _) => {}
        }
        PendingOutput::of(self).map(drop)
    }
}

/// An incomplete output file.
#[derive(Debug)]
pub struct PendingOutput {
    file: File,
    /// Its temporary name, on filesystems without unnamed files.
    named: Option<TempPath>,
}

impl PendingOutput {
    /// Returns a handle to write the draft with.
    pub fn handle(&self) -> io::Result<File> {
        self.file.try_clone()
    }

    fn of(target: &Target) -> io::Result<PendingOutput> {
        let path = match target {
            Target::Stream(stream) => return Ok(PendingOutput { file: stream.try_clone()?, named: None }),
            Target::Mounted(_) => return Ok(PendingOutput { file: tempfile::tempfile()?, named: None }),
            Target::File(path) => path,
        };
        let flags = OFlags::TMPFILE | OFlags::WRONLY | OFlags::CLOEXEC;
        match rustix::fs::open(directory(path), flags, Mode::from_raw_mode(0o666)) {
            Ok(file) => Ok(PendingOutput { file: file.into(), named: None }),
            Err(Errno::OPNOTSUPP | Errno::ISDIR | Errno::INVAL | Errno::NOSYS) => {
                let (file, named) = named(directory(path))?.into_parts();
                Ok(PendingOutput { file, named: Some(named) })
            }
            Err(error) => Err(error.into()),
        }
    }

    fn finish(mut self, target: &Target, before: Before) -> io::Result<()> {
        let path = match target {
            Target::Stream(_) => return self.file.flush(),
            Target::Mounted(path) => {
                self.file.rewind()?;
                let mut place = OpenOptions::new().write(true).truncate(true).open(path)?;
                return io::copy(&mut self.file, &mut place).map(drop);
            }
            Target::File(path) => path,
        };
        let old = match before {
            Before::Any(_) => fs::symlink_metadata(path).ok(),
            Before::Nothing => None,
        };
        if let Some(old) = &old {
            // Fails unless run by the superuser; the file then belongs to this user.
            let _ = std::os::unix::fs::fchown(&self.file, Some(old.uid()), Some(old.gid()));
            self.file.set_permissions(Permissions::from_mode(old.mode()))?;
            // The replacement is on the disk before the old file is given up.
            self.file.sync_all()?;
        }
        let Some(named) = self.named else {
            return match link(&self.file, path) {
                // A link does not replace a file: link to a temporary name first, then rename.
                Err(Errno::EXIST) if before != Before::Nothing => {
                    let beside = |name: &Path| link(&self.file, name).map_err(io::Error::from);
                    let beside = Builder::new().prefix(".metamorph-").make_in(directory(path), beside)?;
                    beside.into_temp_path().persist(path).map_err(|e| e.error)
                }
                linked => linked.map_err(io::Error::from),
            };
        };
        match before {
            Before::Any(_) => named.persist(path),
            Before::Nothing => named.persist_noclobber(path),
        }
        .map_err(|e| e.error)
    }
}

/// Links an unnamed file to a name.
fn link(file: &File, name: &Path) -> rustix::io::Result<()> {
    let from = format!("/proc/self/fd/{}", file.as_raw_fd());
    rustix::fs::linkat(CWD, from, CWD, name, AtFlags::SYMLINK_FOLLOW)
}

fn named(directory: &Path) -> io::Result<tempfile::NamedTempFile> {
    Builder::new().prefix(".metamorph-").permissions(Permissions::from_mode(0o666)).tempfile_in(directory)
}

fn directory(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Destination that a path resolves to, symbolic links followed.
enum Place {
    /// A descriptor of this process.
    Descriptor(PathBuf),
    /// A place in an existing directory, which is not a symbolic link.
    File(PathBuf),
}

/// Returns true if a file is mounted at this place (`mount --bind`). Filesystems that do not say so count as false.
fn is_mount_point(path: &Path) -> bool {
    let found = statx(CWD, path, AtFlags::SYMLINK_NOFOLLOW, StatxFlags::TYPE);
    found.is_ok_and(|file| file.stx_attributes.contains(StatxAttributes::MOUNT_ROOT))
}

/// Refuses a path that leads over a symbolic link of another user in a sticky directory that all may write to.
fn refuse_strange_links(path: &Path) -> io::Result<()> {
    /// The bits of the sticky flag and of the permission of all to write.
    const SHARED: u32 = 0o1002;
    for part in path.ancestors() {
        let (Ok(link), Ok(around)) = (fs::symlink_metadata(part), fs::metadata(directory(part))) else {
            continue;
        };
        let own = rustix::process::geteuid().as_raw();
        let is_strange = link.is_symlink() && link.uid() != own && link.uid() != around.uid();
        if is_strange && around.mode() & SHARED == SHARED {
            return Err(io::Error::other(format!("{} is a symbolic link of another user", part.shown())));
        }
    }
    Ok(())
}

/// Follows symbolic links, also dangling ones.
fn place(path: &Path) -> io::Result<Place> {
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        refuse_strange_links(&path)?;
        let Some(name) = path.file_name().map(OsString::from) else {
            return Ok(Place::File(fs::canonicalize(&path)?));
        };
        let real = fs::canonicalize(directory(&path))?.join(name);
        if real.starts_with("/proc") {
            return Ok(Place::Descriptor(real));
        }
        match fs::read_link(&real) {
            Ok(to) => path = directory(&real).join(to),
            Err(_) => return Ok(Place::File(real)),
        }
    }
    Err(Errno::LOOP.into())
}

/// Opens a device, a pipe or a descriptor, without waiting for a reader.
fn stream(path: &Path) -> io::Result<File> {
    if path.file_name().is_some_and(|name| name == "1") && path.starts_with("/proc") {
        // Opened again, it would start at offset 0 of a file and overwrite what was printed.
        return io::stdout().as_fd().try_clone_to_owned().map(File::from);
    }
    let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits() as i32;
    let opened = OpenOptions::new().append(true).custom_flags(flags).open(path);
    let file = opened.map_err(|error| match Errno::from_io_error(&error) {
        Some(Errno::NXIO) => io::Error::other("it is a pipe that no program reads"),
        _ => error,
    })?;
    fcntl_setfl(&file, OFlags::APPEND)?;
    Ok(file)
}

/// Returns the reason why nothing can be written at a place.
fn reason(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::NotFound => "its directory does not exist".to_owned(),
        io::ErrorKind::PermissionDenied => "this user may not write there".to_owned(),
        _ => error.to_string(),
    }
}

/// The destination of a command's JSON: `--json FILE|-`.
#[derive(Debug)]
pub enum Json {
    /// No JSON.
    Nowhere,
    /// Standard output.
    Out,
    /// A file.
    File(Output),
}

impl Json {
    /// Interprets the option.
    pub fn of(option: Option<&Path>, outputs: &mut Outputs) -> Result<Json, OutputError> {
        Ok(match option {
            None => Json::Nowhere,
            Some(path) if path == Path::new("-") => Json::Out,
            Some(path) => Json::File(outputs.writes("--json", path, OutputKind::Json)?),
        })
    }

    /// Returns true if standard output is taken, so that human-readable text goes elsewhere.
    pub fn is_out(&self) -> bool {
        matches!(self, Json::Out)
    }

    /// Writes a value as JSON.
    pub fn write(&self, numbers: &impl Serialize) -> Result<(), OutputError> {
        match self {
            Json::Nowhere => {}
            Json::Out => print_data(&json(numbers)),
            Json::File(file) => file.write(json(numbers) + "\n")?,
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    fn names(directory: &Path) -> Vec<String> {
        let names = fs::read_dir(directory).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = names.collect();
        names.sort();
        names
    }

    /// A replaced file keeps its permissions, a link stays a link, and the directory contains nothing else:
    /// not while writing, not after giving up, not at the end.
    #[test]
    fn a_file_appears_as_a_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let (old, new, link) = (dir.path().join("old"), dir.path().join("new"), dir.path().join("link"));
        fs::write(&old, "before").unwrap();
        fs::set_permissions(&old, Permissions::from_mode(0o640)).unwrap();
        symlink("old", &link).unwrap();
        let mut outputs = Outputs::default();
        let (over, fresh) =
            (outputs.writes("--a", &link, OutputKind::Any).unwrap(), outputs.creates("--b", &new).unwrap());
        assert_eq!(names(dir.path()), ["link", "old"]);
        for named in [false, true] {
            for output in [&over, &fresh] {
                let draft = |output: &Output| match named {
                    false => output.begin().unwrap(),
                    true => {
                        let (file, named) = super::named(dir.path()).unwrap().into_parts();
                        PendingOutput { file, named: Some(named) }
                    }
                };
                let given_up = draft(output);
                given_up.handle().unwrap().write_all(b"half").unwrap();
                drop(given_up);
                let whole = draft(output);
                whole.handle().unwrap().write_all(b"after").unwrap();
                assert_eq!(
                    fs::read(&old).unwrap(),
                    if output.name == over.name { b"before" } else { &b"after"[..] }
                );
                output.finish(whole).unwrap();
            }
            assert_eq!(names(dir.path()), ["link", "new", "old"]);
            assert_eq!(
                (fs::read(&old).unwrap(), fs::read(&new).unwrap()),
                (b"after".to_vec(), b"after".to_vec())
            );
            assert_eq!(fs::metadata(&old).unwrap().mode() & 0o777, 0o640);
            assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
            // A file created meanwhile is not replaced by `creates`.
            assert!(matches!(fresh.write("again"), Err(OutputError::Write { .. })));
            assert_eq!(fs::read(&new).unwrap(), b"after");
            fs::remove_file(&new).unwrap();
            fs::write(&old, "before").unwrap();
        }
    }

    #[test]
    fn what_may_not_be_written_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("file");
        fs::write(&file, "").unwrap();
        let taken = Outputs::default().creates("--a", &file).unwrap_err().to_string();
        assert!(
            taken.starts_with("--a ") && taken.contains("exists") && taken.contains("fix: name a new"),
            "{taken}"
        );
        for path in ["/proc/none/x", "/dev/none/x", "", "/", "."] {
            let error = Outputs::default().writes("--json", Path::new(path), OutputKind::Json).unwrap_err();
            assert!(error.is_input() && error.to_string().contains("or `-`"), "{path}: {error}");
        }
        if !rustix::process::geteuid().is_root() {
            fs::set_permissions(&file, Permissions::from_mode(0o400)).unwrap();
            assert!(Outputs::default().writes("--json", &file, OutputKind::Json).unwrap_err().is_input());
        }
    }

    #[test]
    fn devices_may_be_written_by_several() {
        let mut outputs = Outputs::default();
        let null = Path::new("/dev/null");
        outputs.reads("the scenario", null);
        for option in ["--json", "--html"] {
            outputs.writes(option, null, OutputKind::Any).unwrap().write("x").unwrap();
        }
        let full = outputs.writes("--json", Path::new("/dev/full"), OutputKind::Json).unwrap();
        assert!(!full.write("x").unwrap_err().is_input());
    }

    /// Another file cannot take the place of a mount point, so its content is replaced.
    #[test]
    fn a_mount_point_is_written_in_place() {
        let dir = tempfile::tempdir().unwrap();
        let (file, other) = (dir.path().join("file"), dir.path().join("other"));
        fs::write(&file, "a longer text than the new one").unwrap();
        let output = Output {
            name: "--json".to_owned(),
            target: Target::Mounted(file.clone()),
            before: Before::Any(OutputKind::Json),
        };
        let inode = fs::metadata(&file).unwrap().ino();
        output.write("new").unwrap();
        assert_eq!((fs::read(&file).unwrap(), fs::metadata(&file).unwrap().ino()), (b"new".to_vec(), inode));
        assert!(!is_mount_point(&file) && !is_mount_point(&other) && is_mount_point(Path::new("/proc")));
    }

    #[test]
    fn links_of_others_in_a_shared_directory_are_not_followed() {
        let dir = tempfile::tempdir().unwrap();
        let (link, target) = (dir.path().join("link"), dir.path().join("target"));
        symlink(&target, &link).unwrap();
        fs::set_permissions(dir.path(), Permissions::from_mode(0o1777)).unwrap();
        assert!(Outputs::default().writes("--json", &link, OutputKind::Json).is_ok());
        if rustix::process::geteuid().is_root() {
            std::os::unix::fs::lchown(&link, Some(1234), None).unwrap();
            for path in [link.clone(), link.join("below")] {
                let error =
                    Outputs::default().writes("--json", &path, OutputKind::Json).unwrap_err().to_string();
                assert!(error.contains("link is a symbolic link of another user"), "{error}");
            }
            fs::set_permissions(dir.path(), Permissions::from_mode(0o777)).unwrap();
            assert!(Outputs::default().writes("--json", &link, OutputKind::Json).is_ok());
        }
    }
}
