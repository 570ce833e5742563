//! What a training is of and what it is made with, as its checkpoints and its weights record it.
//!
//! ```text
//! the settings, and in `data` what is in the folders: `parts`, `frames`, `valid_parts`, `valid_frames`, `sets`
//! first_weights   name, hash and training of weights that were given to begin with
//! made_with       version, kernel, processor, threads
//! earlier         what the first updates were made with, if a later version or another kernel goes on
//! ```

use anyhow::{Result, bail};
use cconv::Kernel;
use fluvia_net::dataset::DataSet;
use fluvia_net::weights::Weights;
use serde_json::{Value, json};

use super::Plan;
use super::config::Config;
use crate::generate;
use crate::record::{Source, first_difference};

const FIRST: &str = "first_weights";
const MADE_WITH: &str = "made_with";
const EARLIER: &str = "earlier";

/// Weights that a training begins with.
pub struct First {
    pub weights: Weights,
    pub source: Source,
}

/// Of a training that begins.
pub fn of(plan: &Plan, train: &DataSet, valid: Option<&DataSet>, first: Option<&First>) -> Result<Value> {
    let mut value = recorded(&plan.config)?;
    let data = &mut value["data"];
    let frames = |set: &DataSet| set.parts().iter().map(|part| part.frames).sum::<usize>();
    data["parts"] = json!(train.parts().len());
    data["frames"] = json!(frames(train));
    data["valid_parts"] = json!(valid.map_or(0, |set| set.parts().len()));
    data["valid_frames"] = json!(valid.map_or(0, frames));
    let sets = plan.config.data.train.iter().map(|folder| generate::settings_of(folder));
    data["sets"] = json!(sets.collect::<Result<Vec<_>>>()?);
    value[FIRST] = first.map_or(Value::Null, |First { weights, source }| {
        let training = weights.training.as_deref().map(|text| {
            // Not ours, if it is no JSON.
            serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()))
        });
        json!({ "name": source.name, "sha256": source.sha256, "training": training })
    });
    value[MADE_WITH] = json!({
        "version": env!("CARGO_PKG_VERSION"),
        "kernel": Kernel::detect().name(),
        "processor": processor(),
        "threads": rayon::current_num_threads(),
    });
    Ok(value)
}

/// Of a training that goes on after so many updates, from what its checkpoint has and what a training of now would have;
/// and what to warn of. Data may have moved: what is in their folders counts.
///
/// # Errors
/// If it is another training.
pub fn going_on(mut old: Value, mut new: Value, updates: u64) -> Result<(Value, Vec<String>)> {
    // What settings did not have yet is as it is without them.
    complete(&mut old, &recorded(&Config::default())?);
    let (was, is) = (take(&mut old, MADE_WITH), take(&mut new, MADE_WITH));
    let mut earlier = take(&mut old, EARLIER);
    // A checkpoint needs no weights to begin with.
    let (began, given) = (take(&mut old, FIRST), take(&mut new, FIRST));
    if !given.is_null() && began["sha256"] != given["sha256"] {
        let named = |first: &Value| match first["sha256"].as_str() {
            Some(hash) => format!("{} with hash {}", first["name"], hash.get(..8).unwrap_or(hash)),
            None => "none".to_owned(),
        };
        bail!("not the same training, its {FIRST}: {}, now: {}", named(&began), named(&given));
    }
    let mut warnings = Vec::new();
    for key in ["train", "valid"] {
        let (was, is) = (take(&mut old["data"], key), &new["data"][key]);
        if was != *is {
            warnings.push(format!("data.{key} was {was} and is {is} now"));
        }
        old["data"][key] = is.clone();
    }
    if let Some((key, old, new)) = first_difference("", &old, &new) {
        bail!("not the same training, its {key}: {old}, now: {new}");
    }
    if was["kernel"] != is["kernel"] || was["version"] != is["version"] {
        if was["kernel"] != is["kernel"] {
            warnings.push(format!(
                "begun with the kernel {}, going on with {}: other bits than without the change",
                was["kernel"], is["kernel"]
            ));
        }
        let mut until = was;
        until["until_update"] = json!(updates);
        match &mut earlier {
            Value::Array(list) => list.push(until),
            none => *none = json!([until]),
        }
    }
    new[FIRST] = began;
    new[MADE_WITH] = is;
    if !earlier.is_null() {
        new[EARLIER] = earlier;
    }
    Ok((new, warnings))
}

/// The settings as they are recorded: through a text, in which a float of 32 bits is 0.02 and not 0.019999999552965164.
fn recorded(config: &Config) -> Result<Value> {
    Ok(serde_json::from_str(&serde_json::to_string(config)?)?)
}

/// Adds the entries that `value` does not have, at every depth.
fn complete(value: &mut Value, defaults: &Value) {
    let (Value::Object(entries), Value::Object(defaults)) = (value, defaults) else { return };
    for (key, default) in defaults {
        match entries.get_mut(key) {
            Some(own) => complete(own, default),
            None => {
                entries.insert(key.clone(), default.clone());
            }
        }
    }
}

/// Removes an entry; null if there is none.
fn take(value: &mut Value, key: &str) -> Value {
    value.as_object_mut().and_then(|entries| entries.remove(key)).unwrap_or_default()
}

/// The name of the processor, as far as the system tells it.
fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or(std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn origin() -> Value {
        let mut value = recorded(&Config::default()).unwrap();
        value[FIRST] = json!({ "name": "a", "sha256": "1" });
        value[MADE_WITH] = json!({ "version": "1", "kernel": "avx2", "threads": 2 });
        value
    }

    #[test]
    fn numbers_are_recorded_as_they_are_written() {
        assert_eq!(origin()["network"]["dt"].to_string(), "0.02");
    }

    #[test]
    fn threads_and_files_that_are_gone_do_not_matter() {
        let mut now = origin();
        now[MADE_WITH]["threads"] = json!(8);
        now[FIRST] = Value::Null;
        let (found, warnings) = going_on(origin(), now, 5).unwrap();
        assert_eq!((&found[FIRST]["name"], warnings), (&json!("a"), vec![]));
        assert!(found[EARLIER].is_null());
    }

    #[test]
    fn another_kernel_is_warned_of_and_recorded() {
        let mut now = origin();
        now[MADE_WITH]["kernel"] = json!("avx512");
        let (found, warnings) = going_on(origin(), now.clone(), 5).unwrap();
        assert!(warnings[0].contains("avx512"));
        assert_eq!(
            (&found[MADE_WITH]["kernel"], &found[EARLIER][0]["kernel"]),
            (&json!("avx512"), &json!("avx2"))
        );
        assert_eq!(found[EARLIER][0]["until_update"], 5);
        // Once.
        let (again, warnings) = going_on(found.clone(), now.clone(), 7).unwrap();
        assert_eq!((again, warnings), (found, vec![]));
        // Another version makes the same bits, or says so in the changelog.
        now[MADE_WITH] = json!({ "version": "2", "kernel": "avx2" });
        let (found, warnings) = going_on(origin(), now, 5).unwrap();
        assert_eq!((&found[EARLIER][0]["version"], warnings), (&json!("1"), vec![]));
    }

    #[test]
    fn data_may_move_and_not_change() {
        let mut now = origin();
        now["data"]["train"] = json!(["elsewhere/train"]);
        let (found, warnings) = going_on(origin(), now.clone(), 5).unwrap();
        assert_eq!(found["data"]["train"], json!(["elsewhere/train"]));
        assert!(warnings.len() == 1 && warnings[0].contains("elsewhere/train"), "{warnings:?}");
        now["data"]["frames"] = json!(7);
        assert!(going_on(origin(), now, 5).unwrap_err().to_string().contains("data.frames"));
    }

    #[test]
    fn other_settings_and_weights_are_refused_and_new_keys_are_not() {
        let fault = |change: &dyn Fn(&mut Value)| {
            let mut now = origin();
            change(&mut now);
            going_on(origin(), now, 5).unwrap_err().to_string()
        };
        assert!(fault(&|now| now["training"]["batch"] = json!(3)).contains("training.batch: 16, now: 3"));
        let other = fault(&|now| now[FIRST]["sha256"] = json!("2"));
        assert!(other.contains(FIRST) && other.contains("hash 1") && other.contains("hash 2"), "{other}");
        let mut old = origin();
        take(&mut old["training"], "lead");
        going_on(old, origin(), 5).unwrap();
    }
}
