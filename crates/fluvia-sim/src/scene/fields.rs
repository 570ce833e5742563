//! The entries of a JSON object, by key and type; messages name the whole path of the key.

use super::json::Node;

/// The result of reading; the error is the message without the path of the file.
pub(super) type Parsed<T> = Result<T, String>;

/// Which numbers are allowed.
#[derive(Clone, Copy)]
pub(super) enum Allowed {
    Any,
    NonNegative,
    Positive,
}

/// An object whose keys are all known and there once.
pub(super) struct Fields<'a> {
    path: String,
    entries: &'a [(String, Node)],
}

impl<'a> Fields<'a> {
    /// The entries of `node`, which is found at `path` (empty at the top) and is `what` ("a scene").
    pub(super) fn of(node: &'a Node, path: &str, what: &str, known: &[&str]) -> Parsed<Fields<'a>> {
        let list = || known.join(", ");
        let Node::Object(entries) = node else {
            let at = if path.is_empty() { String::new() } else { format!("`{path}`: ") };
            return Err(format!("{at}{}, expected {what}: an object with {}", node.describe(), list()));
        };
        let fields = Fields { path: path.into(), entries };
        for (i, (key, _)) in entries.iter().enumerate() {
            if !known.contains(&key.as_str()) {
                let hint = match nearest(key, known) {
                    Some(near) => format!("did you mean `{near}`? "),
                    None => String::new(),
                };
                let key = key.escape_debug().to_string();
                return Err(format!("unknown key `{}`: {hint}{what} has {}", fields.at(&key), list()));
            }
            if entries[..i].iter().any(|entry| entry.0 == *key) {
                return Err(format!("key `{}` is there twice", fields.at(key)));
            }
        }
        Ok(fields)
    }

    /// The path of a key.
    pub(super) fn at(&self, key: &str) -> String {
        if self.path.is_empty() { key.into() } else { format!("{}.{key}", self.path) }
    }

    pub(super) fn get(&self, key: &str) -> Option<&'a Node> {
        self.entries.iter().find(|entry| entry.0 == key).map(|entry| &entry.1)
    }

    /// The error for a value that is not what was expected.
    pub(super) fn wrong<T>(&self, key: &str, node: &Node, expected: &str) -> Parsed<T> {
        Err(format!("`{}`: {}, expected {expected}", self.at(key), node.describe()))
    }

    pub(super) fn list(&self, key: &str, of: &str) -> Parsed<&'a [Node]> {
        match self.get(key) {
            Some(Node::List(list)) => Ok(list),
            Some(node) => self.wrong(key, node, &format!("a list of {of}")),
            None => Err(format!("no key `{}`, expected a list of {of}", self.at(key))),
        }
    }

    pub(super) fn text(&self, key: &str, what: &str) -> Parsed<Option<&'a str>> {
        match self.get(key) {
            Some(Node::Text(text)) if text.is_empty() => {
                Err(format!("`{}`: empty, expected {what}", self.at(key)))
            }
            // It comes back in messages, which are one line.
            Some(Node::Text(text)) if text.contains(char::is_control) => {
                Err(format!("`{}`: `{}`, expected {what}", self.at(key), text.escape_debug()))
            }
            Some(Node::Text(text)) => Ok(Some(text)),
            Some(node) => self.wrong(key, node, what),
            None => Ok(None),
        }
    }

    pub(super) fn flag(&self, key: &str) -> Parsed<Option<bool>> {
        match self.get(key) {
            Some(Node::Flag(flag)) => Ok(Some(*flag)),
            Some(node) => self.wrong(key, node, "true or false"),
            None => Ok(None),
        }
    }

    /// A step: a whole number of at least `least`.
    pub(super) fn step(&self, key: &str, least: u64) -> Parsed<Option<u64>> {
        // Up to here an f64 holds every whole number.
        const MOST: f64 = (1_u64 << 53) as f64;
        match self.get(key) {
            Some(Node::Number(x)) if x.fract() == 0.0 && *x >= least as f64 && *x <= MOST => {
                Ok(Some(*x as u64))
            }
            Some(node) => self.wrong(key, node, &format!("a whole number of at least {least}")),
            None => Ok(None),
        }
    }

    pub(super) fn number(&self, key: &str, allowed: Allowed, unit: &str) -> Parsed<Option<f32>> {
        match self.get(key) {
            Some(node) => match finite(node, allowed) {
                Some(x) => Ok(Some(x)),
                None => self.wrong(key, node, &format!("{}, {unit}", describe(allowed))),
            },
            None => Ok(None),
        }
    }

    pub(super) fn vector(&self, key: &str, allowed: Allowed, unit: &str) -> Parsed<Option<[f32; 3]>> {
        let Some(node) = self.get(key) else { return Ok(None) };
        let expected = format!("three times {}, {unit}", describe(allowed));
        let Node::List(list) = node else { return self.wrong(key, node, &expected) };
        let [x, y, z] = &list[..] else { return self.wrong(key, node, &expected) };
        let mut vector = [0.0; 3];
        for (k, item) in [x, y, z].into_iter().enumerate() {
            let Some(number) = finite(item, allowed) else {
                return self.wrong(&format!("{key}[{k}]"), item, &expected);
            };
            vector[k] = number;
        }
        Ok(Some(vector))
    }
}

/// The number, if it is one, allowed, and one in float32.
fn finite(node: &Node, allowed: Allowed) -> Option<f32> {
    let Node::Number(number) = node else { return None };
    let number = *number as f32;
    let is_allowed = match allowed {
        Allowed::Any => true,
        Allowed::NonNegative => number >= 0.0,
        Allowed::Positive => number > 0.0,
    };
    (number.is_finite() && is_allowed).then_some(number)
}

fn describe(allowed: Allowed) -> &'static str {
    match allowed {
        Allowed::Any => "a finite number",
        Allowed::NonNegative => "a number that is not negative",
        Allowed::Positive => "a positive number",
    }
}

/// The known key that was probably meant, if one is near: one edit, and one more for every two letters.
fn nearest<'k>(key: &str, known: &[&'k str]) -> Option<&'k str> {
    // Long keys have no near one, and distances take time with their length.
    const LONGEST: usize = 64;
    if key.len() > LONGEST {
        return None;
    }
    let plain = key.to_lowercase();
    let distance = |name: &str| {
        let is_part = plain.len() >= 3 && (name.contains(&plain) || plain.contains(name));
        if is_part { 1 } else { strsim::damerau_levenshtein(&plain, name) }
    };
    let near = known.iter().min_by_key(|name| distance(name))?;
    (distance(near) <= 1 + plain.len() / 2).then_some(*near)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_keys() {
        let known = ["path", "particles", "translation", "velocity", "particle_radius", "scale"];
        for (key, near) in [
            ("velocty", Some("velocity")),
            ("Velocity", Some("velocity")),
            ("translate", Some("translation")),
            ("particleRadius", Some("particle_radius")),
            ("radius", Some("particle_radius")),
            ("scaling", Some("scale")),
            ("Configuration", None),
            ("x", None),
            ("", None),
        ] {
            assert_eq!(nearest(key, &known), near, "{key}");
        }
    }
}
