//! The configuration of a server, and its one precedence: flags before environment before file before defaults.
//!
//! A setting `limits.views` of the file is `SIGHTLINE__LIMITS__VIEWS` in the environment (two underscores, since
//! orchestrators put variables with one of their own there). What is in neither the file nor the environment has its
//! default; a name that no setting has is an error in both. A list stands in the environment with commas between.

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::{Limits, MAX_READ_AHEAD_S, origins};

/// Beginning of the environment variables that are settings.
pub const ENVIRONMENT_PREFIX: &str = "SIGHTLINE__";

/// All settings. Paths are relative to where the server is started.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The address to listen on.
    pub listen: String,
    /// Seconds that calls under way get when the server is told to stop.
    pub draining_s: f64,
    /// File that keeps exercises across restarts, made when there is none; empty: they end with the server.
    pub state: String,
    /// New file for a recording of all that happens to views, for `sightline replay`, or a folder in which each start
    /// makes one; empty: none.
    pub record: String,
    /// Greatest size of the recording in MiB. When it is reached the recording ends, and the server goes on.
    pub record_limit_mib: u32,
    /// Memory for pages of the database in MiB. What does not fit is read again when it is needed.
    pub page_cache_mib: u32,
    /// Seconds by which pages are read ahead of views that move, at most 10; 0: not at all.
    pub read_ahead_s: f64,
    /// Layout of the log: `text` or `json`.
    pub log: LogLayout,
    /// Certificates.
    pub tls: TlsFiles,
    /// Who may call.
    pub access: AccessFiles,
    /// What is allowed.
    pub limits: Limits,
}

/// Layout of the log.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogLayout {
    /// For people.
    #[default]
    Text,
    /// One document a line.
    Json,
}

/// Files of certificates, PEM; all empty: no TLS.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TlsFiles {
    /// The server's certificate and those between it and an authority.
    pub certificate: String,
    /// Its key.
    pub key: String,
    /// The authorities that sign clients' certificates; empty: clients need none.
    pub client_authorities: String,
}

/// Who may call.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AccessFiles {
    /// File of tokens; empty: everyone may do everything.
    pub tokens: String,
    /// Other origins whose pages may call from a browser, such as `https://viewer.example`; `*`: all.
    pub origins: Vec<String>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            listen: "127.0.0.1:7410".into(),
            draining_s: 5.0,
            state: String::new(),
            record: String::new(),
            record_limit_mib: 1_024,
            page_cache_mib: 256,
            read_ahead_s: 0.25,
            log: LogLayout::default(),
            tls: TlsFiles::default(),
            access: AccessFiles::default(),
            limits: Limits::default(),
        }
    }
}

impl Config {
    /// The settings of a file's `text` (if there is one), overruled by the `environment`'s. Errors show the line.
    pub fn read(text: Option<&str>, environment: impl Iterator<Item = (String, String)>) -> Result<Self, String> {
        let text = text.unwrap_or_default();
        // Alone first: these errors point into the text.
        toml::from_str::<Self>(text).map_err(|error| error.to_string())?;
        let mut table: Table = text.parse().map_err(|error: toml::de::Error| error.to_string())?;
        let known = Table::try_from(Self::default()).map_err(|error| error.to_string())?;
        for (name, value) in environment {
            if let Some(path) = name.strip_prefix(ENVIRONMENT_PREFIX) {
                let path: Vec<String> = path.split("__").map(str::to_ascii_lowercase).collect();
                overrule(&mut table, &known, &path, &value).map_err(|why| format!("{name}: {why}"))?;
            }
        }
        let config: Self = table.try_into().map_err(|error: toml::de::Error| error.to_string())?;
        config.check().map(|()| config)
    }

    /// Says what makes no sense.
    pub fn check(&self) -> Result<(), String> {
        self.limits.check()?;
        origins::check(&self.access.origins)?;
        if !(0.0..=3_600.0).contains(&self.draining_s) {
            return Err(format!("draining_s is {}; it must be from 0 to 3600", self.draining_s));
        }
        if !(0.0..=MAX_READ_AHEAD_S).contains(&self.read_ahead_s) {
            return Err(format!("read_ahead_s is {}; it must be from 0 to {MAX_READ_AHEAD_S}", self.read_ahead_s));
        }
        if self.record_limit_mib == 0 {
            return Err("record_limit_mib is 0: nothing could be recorded; an empty `record` records nothing".into());
        }
        if self.tls.certificate.is_empty() != self.tls.key.is_empty() {
            return Err("tls.certificate and tls.key belong together: give both or neither".into());
        }
        if self.tls.certificate.is_empty() && !self.tls.client_authorities.is_empty() {
            return Err("tls.client_authorities needs tls.certificate and tls.key".into());
        }
        Ok(())
    }

    /// As a file that says the same.
    pub fn print(&self) -> Result<String, String> {
        toml::to_string(self).map_err(|error| error.to_string())
    }
}

/// Puts a value of the environment, as the kind that the default has.
fn overrule(table: &mut Table, known: &Table, path: &[String], text: &str) -> Result<(), String> {
    let (first, rest) = path.split_first().ok_or("it names no setting")?;
    match (known.get(first), rest) {
        (Some(Value::Table(known)), [_, ..]) => {
            let inner = table.entry(first.clone()).or_insert_with(|| Value::Table(Table::new()));
            overrule(inner.as_table_mut().ok_or("the file has no table there")?, known, rest, text)
        }
        (Some(default), []) => {
            let value = match default {
                Value::Integer(_) => Value::Integer(text.parse().map_err(|_| format!("'{text}' is no whole number"))?),
                Value::Float(_) => Value::Float(text.parse().map_err(|_| format!("'{text}' is no number"))?),
                Value::String(_) => Value::String(text.to_owned()),
                Value::Array(_) => {
                    let parts = text.split(',').map(str::trim).filter(|part| !part.is_empty());
                    Value::Array(parts.map(|part| Value::String(part.to_owned())).collect())
                }
                _ => return Err("it names a group of settings".into()),
            };
            table.insert(first.clone(), value);
            Ok(())
        }
        _ => Err("there is no such setting".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, environment: &[(&str, &str)]) -> Result<Config, String> {
        Config::read(Some(text), environment.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())))
    }

    #[test]
    fn environment_overrules_file_and_file_overrules_defaults() {
        let text = "listen = \"a\"\n[limits]\nviews = 7\ntriangles = 9000\n";
        let environment = [("SIGHTLINE__LIMITS__VIEWS", "8"), ("SIGHTLINE__TLS__KEY", ""), ("SIGHTLINE_PORT", "x")];
        let config = read(text, &environment).unwrap();
        assert_eq!((config.limits.views, config.limits.triangles, config.listen.as_str()), (8, 9_000, "a"));
        assert_eq!(config.limits.batch_lines, Limits::default().batch_lines);
        assert_eq!(Config::read(None, std::iter::empty()), Ok(Config::default()));
        let list = read("", &[("SIGHTLINE__ACCESS__ORIGINS", "https://a.example, http://b:1")]).unwrap();
        assert_eq!(list.access.origins, ["https://a.example", "http://b:1"]);
        assert_eq!(read("[access]\norigins = [\"https://a.example\", \"http://b:1\"]\n", &[]).unwrap(), list);
        // What is printed says the same.
        assert_eq!(read(&config.print().unwrap(), &[]).unwrap(), config);
    }

    #[test]
    fn what_makes_no_sense_is_named() {
        for (text, environment, words) in [
            ("[limits]\nveiws = 7\n", &[][..], "veiws"),
            ("", &[("SIGHTLINE__LIMITS__VEIWS", "7")], "SIGHTLINE__LIMITS__VEIWS: there is no such setting"),
            ("", &[("SIGHTLINE__LIMITS__VIEWS", "many")], "no whole number"),
            ("", &[("SIGHTLINE__LIMITS", "7")], "group"),
            ("[limits]\nviews = 0\n", &[], "limits.views is 0"),
            ("[limits]\nviews = -1\n", &[], "line 2"),
            ("draining_s = 1e9\n", &[], "draining_s"),
            ("[tls]\nkey = \"k\"\n", &[], "belong together"),
            ("[tls]\nclient_authorities = \"k\"\n", &[], "needs tls.certificate"),
            ("record_limit_mib = 0\n", &[], "record_limit_mib"),
            ("read_ahead_s = -0.1\n", &[], "read_ahead_s is -0.1; it must be from 0 to 10"),
            ("log = \"xml\"\n", &[], "xml"),
            ("[access]\norigins = [\"https://a.example/\"]\n", &[], "access.origins"),
        ] {
            let error = read(text, environment).unwrap_err();
            assert!(error.contains(words), "'{words}' in: {error}");
        }
    }
}
