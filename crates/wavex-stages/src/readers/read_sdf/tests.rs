//! Configuration keys. `tests/readers/sdf` covers reading.

use super::*;
use wavex_line::stage::Config as _;

fn check(keys: &str) -> std::result::Result<(), InvalidKey> {
    toml::from_str::<ReadSdf>(&format!("path = \"a.sdf\"\n{keys}")).unwrap().check()
}

#[test]
fn keys_that_cannot_be_are_refused() {
    assert_eq!(check("index_dir = \"i\"\ntime_s = [1, 1]\ngps_date = \"2013-06-21\""), Ok(()));
    let window = "it must be two numbers, the first not above the second";
    for (keys, key, problem) in [
        ("library = \"\"", "library", "the path is empty"),
        ("index_dir = \"\"", "index_dir", "the path is empty"),
        ("time_s = [2.0, 1.0]", "time_s", window),
        ("gps_date = \"21.6.2013\"", "gps_date", "it must be a day from 1980-01-06 on, as in 2013-06-21"),
    ] {
        assert_eq!(check(keys), Err(InvalidKey::new(key, problem)));
    }
    for (path, problem) in [
        ("[]", "at least one file is needed"),
        ("\"\"", "a path is empty"),
        ("\"-\"", "standard input cannot be read: give a file"),
    ] {
        let config: ReadSdf = toml::from_str(&format!("path = {path}")).unwrap();
        assert_eq!(config.check(), Err(InvalidKey::new("path", problem)));
    }
}
