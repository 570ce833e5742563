//! The part of Python's pickle format that a file of tensors is written in.
//!
//! A pickle is a program for a stack machine that builds objects. Here nothing of it is executed: the name of
//! a class or function stays a name ([`Value::Global`]) and a call stays a note of who was to be called with
//! what ([`Value::Call`]). Every opcode makes at most one value and values refer to each other by index, so
//! memory is linear in the length of the pickle and an object used twice is held once.

use std::collections::HashMap;

/// The index of a value.
pub(super) type Id = usize;

/// A Python object, as far as it is told apart.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Integer(i64),
    Text(String),
    List(Vec<Id>),
    Tuple(Vec<Id>),
    /// Keys and values, in the order they were set.
    Dict(Vec<(Id, Id)>),
    /// The name of a class or function.
    Global {
        module: String,
        name: String,
    },
    /// What would be called, and the tuple of arguments.
    Call {
        function: Id,
        arguments: Id,
    },
    /// A reference to data outside of the pickle.
    Persistent(Id),
    /// None, truth values, floats, bytes, long integers: nothing that describes a tensor.
    Other,
}

/// A pickle that was read to its end.
#[derive(Debug)]
pub(super) struct Pickle {
    values: Vec<Value>,
    root: Id,
}

impl Pickle {
    /// Reads a pickle of protocol 2 to 5.
    pub fn parse(bytes: &[u8]) -> Result<Pickle, String> {
        let mut machine = Machine::default();
        let mut input = Input { bytes, position: 0 };
        loop {
            let position = input.position;
            match machine.step(&mut input) {
                Ok(None) => {}
                Ok(Some(root)) => return Ok(Pickle { values: machine.values, root }),
                Err(fault) => return Err(format!("pickle, byte {position}: {fault}")),
            }
        }
    }

    /// The object that was pickled.
    pub fn root(&self) -> Id {
        self.root
    }

    /// The value at an index that came out of this pickle.
    pub fn get(&self, id: Id) -> &Value {
        &self.values[id]
    }

    /// The items of a tuple or list.
    pub fn items(&self, id: Id) -> Option<&[Id]> {
        match self.get(id) {
            Value::List(items) | Value::Tuple(items) => Some(items),
            _ => None,
        }
    }

    /// A whole number that is not negative.
    pub fn size(&self, id: Id) -> Option<usize> {
        match *self.get(id) {
            Value::Integer(number) => usize::try_from(number).ok(),
            _ => None,
        }
    }

    /// A text.
    pub fn text(&self, id: Id) -> Option<&str> {
        match self.get(id) {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    /// The module and name of a class or function.
    pub fn global(&self, id: Id) -> Option<(&str, &str)> {
        match self.get(id) {
            Value::Global { module, name } => Some((module, name)),
            _ => None,
        }
    }
}

#[derive(Default)]
struct Machine {
    values: Vec<Value>,
    stack: Vec<Id>,
    /// Heights of the stack at the open marks.
    marks: Vec<usize>,
    memo: HashMap<usize, Id>,
}

impl Machine {
    /// Interprets one opcode; gives the root at the end.
    fn step(&mut self, input: &mut Input<'_>) -> Result<Option<Id>, String> {
        let opcode = input.byte()?;
        match opcode {
            // PROTO and FRAME only announce what follows.
            0x80 => _ = input.byte()?,
            0x95 => _ = input.take(8)?,
            b'.' => return self.pop().map(Some),
            b'(' => self.marks.push(self.stack.len()),
            b'0' => _ = self.pop()?,
            b'1' => _ = self.pop_to_mark()?,
            b'2' => {
                let top = self.top()?;
                self.stack.push(top);
            }
            // None, True, False, a float.
            b'N' | 0x88 | 0x89 => self.push(Value::Other),
            b'G' => {
                input.take(8)?;
                self.push(Value::Other);
            }
            b'J' => {
                let number = input.array().map(i32::from_le_bytes)?;
                self.push(Value::Integer(number.into()));
            }
            b'K' => {
                let number = input.byte()?;
                self.push(Value::Integer(number.into()));
            }
            b'M' => {
                let number = input.array().map(u16::from_le_bytes)?;
                self.push(Value::Integer(number.into()));
            }
            0x8a => {
                let length = input.length(1)?;
                let number = long(input.take(length)?);
                self.push(number);
            }
            0x8b => {
                let length = input.length(4)?;
                let number = long(input.take(length)?);
                self.push(number);
            }
            // Texts, with lengths of 1, 4 and 8 bytes; 'T' and 'U' are byte strings of Python 2.
            0x8c | b'U' => self.push_text(input, 1)?,
            b'X' | b'T' => self.push_text(input, 4)?,
            0x8d => self.push_text(input, 8)?,
            // Byte strings, with lengths of 1, 4 and 8 bytes.
            b'C' | b'B' | 0x8e | 0x96 => {
                let width = match opcode {
                    b'C' => 1,
                    b'B' => 4,
                    _ => 8,
                };
                let length = input.length(width)?;
                input.take(length)?;
                self.push(Value::Other);
            }
            b')' => self.push(Value::Tuple(Vec::new())),
            0x85..=0x87 => {
                let mut items = Vec::new();
                for _ in 0x85..=opcode {
                    items.push(self.pop()?);
                }
                items.reverse();
                self.push(Value::Tuple(items));
            }
            b't' | 0x91 => {
                let items = self.pop_to_mark()?;
                self.push(Value::Tuple(items));
            }
            b']' | 0x8f => self.push(Value::List(Vec::new())),
            b'l' => {
                let items = self.pop_to_mark()?;
                self.push(Value::List(items));
            }
            b'a' => {
                let item = self.pop()?;
                self.append(vec![item])?;
            }
            b'e' | 0x90 => {
                let items = self.pop_to_mark()?;
                self.append(items)?;
            }
            b'}' => self.push(Value::Dict(Vec::new())),
            b'd' => {
                let items = self.pop_to_mark()?;
                self.push(Value::Dict(Vec::new()));
                self.set_items(&items)?;
            }
            b's' => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.set_items(&[key, value])?;
            }
            b'u' => {
                let items = self.pop_to_mark()?;
                self.set_items(&items)?;
            }
            b'c' => {
                let module = input.line()?;
                let name = input.line()?;
                self.push(Value::Global { module, name });
            }
            0x93 => {
                let name = self.pop_text()?;
                let module = self.pop_text()?;
                self.push(Value::Global { module, name });
            }
            // REDUCE and NEWOBJ; NEWOBJ_EX has named arguments too.
            b'R' | 0x81 | 0x92 => {
                if opcode == 0x92 {
                    self.pop()?;
                }
                let arguments = self.pop()?;
                let function = self.pop()?;
                let result = self.call(function, arguments);
                self.push(result);
            }
            // BUILD sets attributes of an object; none of them describes a tensor.
            b'b' => {
                self.pop()?;
                self.top()?;
            }
            b'Q' => {
                let reference = self.pop()?;
                self.push(Value::Persistent(reference));
            }
            b'q' => {
                let index = input.length(1)?;
                self.memorize(index)?;
            }
            b'r' => {
                let index = input.length(4)?;
                self.memorize(index)?;
            }
            0x94 => self.memorize(self.memo.len())?,
            b'h' => {
                let index = input.length(1)?;
                self.recall(index)?;
            }
            b'j' => {
                let index = input.length(4)?;
                self.recall(index)?;
            }
            _ => return Err(format!("opcode {opcode:#04x} is none that a file of tensors needs")),
        }
        Ok(None)
    }

    /// What a call gives: dictionaries are made, everything else stays a note.
    fn call(&self, function: Id, arguments: Id) -> Value {
        let is_dict = matches!(
            &self.values[function],
            Value::Global { module, name }
                if module == "collections" && (name == "OrderedDict" || name == "defaultdict")
        );
        if is_dict { Value::Dict(self.pairs(arguments)) } else { Value::Call { function, arguments } }
    }

    /// The entries given to a dictionary as a list of pairs, as Python 2 pickled it.
    fn pairs(&self, arguments: Id) -> Vec<(Id, Id)> {
        let items = |id: Id| match &self.values[id] {
            Value::List(items) | Value::Tuple(items) => items.as_slice(),
            _ => &[],
        };
        let pair = |&id: &Id| match *items(id) {
            [key, value] => Some((key, value)),
            _ => None,
        };
        items(arguments).first().map_or_else(Vec::new, |&list| items(list).iter().filter_map(pair).collect())
    }

    fn append(&mut self, items: Vec<Id>) -> Result<(), String> {
        let top = self.top()?;
        if let Value::List(list) = &mut self.values[top] {
            list.extend(items);
        }
        Ok(())
    }

    fn set_items(&mut self, items: &[Id]) -> Result<(), String> {
        if !items.len().is_multiple_of(2) {
            return Err("a key without a value".into());
        }
        let top = self.top()?;
        if let Value::Dict(entries) = &mut self.values[top] {
            entries.extend(items.chunks_exact(2).map(|pair| (pair[0], pair[1])));
        }
        Ok(())
    }

    fn push(&mut self, value: Value) {
        self.stack.push(self.values.len());
        self.values.push(value);
    }

    fn push_text(&mut self, input: &mut Input<'_>, width: usize) -> Result<(), String> {
        let length = input.length(width)?;
        let text = std::str::from_utf8(input.take(length)?).map_err(|_| "a text that is not UTF-8")?;
        self.push(Value::Text(text.to_owned()));
        Ok(())
    }

    fn top(&self) -> Result<Id, String> {
        let floor = self.marks.last().copied().unwrap_or(0);
        self.stack[floor.min(self.stack.len())..].last().copied().ok_or_else(|| "the stack is empty".into())
    }

    fn pop(&mut self) -> Result<Id, String> {
        let top = self.top()?;
        self.stack.pop();
        Ok(top)
    }

    fn pop_text(&mut self) -> Result<String, String> {
        let top = self.pop()?;
        match &self.values[top] {
            Value::Text(text) => Ok(text.clone()),
            _ => Err("a name that is not a text".into()),
        }
    }

    fn pop_to_mark(&mut self) -> Result<Vec<Id>, String> {
        let mark = self.marks.pop().ok_or("no mark on the stack")?;
        Ok(self.stack.split_off(mark))
    }

    fn memorize(&mut self, index: usize) -> Result<(), String> {
        let top = self.top()?;
        self.memo.insert(index, top);
        Ok(())
    }

    fn recall(&mut self, index: usize) -> Result<(), String> {
        let id = *self.memo.get(&index).ok_or_else(|| format!("nothing was stored as number {index}"))?;
        self.stack.push(id);
        Ok(())
    }
}

/// A long integer, little-endian in two's complement.
fn long(bytes: &[u8]) -> Value {
    if bytes.len() > 8 {
        return Value::Other;
    }
    let negative = bytes.last().is_some_and(|&byte| byte >= 0x80);
    let mut word = if negative { [0xff; 8] } else { [0; 8] };
    word[..bytes.len()].copy_from_slice(bytes);
    Value::Integer(i64::from_le_bytes(word))
}

struct Input<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Input<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let rest = &self.bytes[self.position..];
        let taken = rest
            .get(..count)
            .ok_or_else(|| format!("ends too early: {count} bytes expected, {} found", rest.len()))?;
        self.position += count;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, String> {
        Ok(self.take(1)?[0])
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        Ok(self.take(N)?.try_into().expect("take gives as many bytes as were asked for"))
    }

    /// An unsigned number of `width` bytes.
    fn length(&mut self, width: usize) -> Result<usize, String> {
        let mut word = [0; 8];
        word[..width].copy_from_slice(self.take(width)?);
        usize::try_from(u64::from_le_bytes(word)).map_err(|_| "a length beyond memory".into())
    }

    fn line(&mut self) -> Result<String, String> {
        let rest = &self.bytes[self.position..];
        let end = rest.iter().position(|&byte| byte == b'\n').ok_or("a name without an end")?;
        let line = std::str::from_utf8(&rest[..end]).map_err(|_| "a name that is not UTF-8")?;
        self.position += end + 1;
        Ok(line.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dictionary_keeps_the_order_and_shares_what_is_used_twice() {
        // pickle.dumps({'a': x, 'b': x}, 2) with x = [1, -2]
        let pickle =
            Pickle::parse(b"\x80\x02}q\x00(X\x01\x00\x00\x00aq\x01]q\x02(K\x01J\xfe\xff\xff\xffeX\x01\x00\x00\x00bq\x03h\x02u.")
                .unwrap();
        let Value::Dict(entries) = pickle.get(pickle.root()) else { panic!("not a dictionary") };
        assert_eq!(entries.iter().map(|&(key, _)| pickle.text(key).unwrap()).collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!(entries[0].1, entries[1].1);
        let numbers = pickle.items(entries[0].1).unwrap();
        assert_eq!(pickle.get(numbers[0]), &Value::Integer(1));
        assert_eq!(pickle.get(numbers[1]), &Value::Integer(-2));
        assert_eq!(pickle.size(numbers[1]), None);
    }

    #[test]
    fn a_call_is_noted_and_not_made() {
        // os.system('ls')
        let pickle = Pickle::parse(b"\x80\x02cos\nsystem\nX\x02\x00\x00\x00ls\x85R.").unwrap();
        let Value::Call { function, arguments } = *pickle.get(pickle.root()) else { panic!("not a call") };
        assert_eq!(pickle.global(function), Some(("os", "system")));
        assert_eq!(pickle.text(pickle.items(arguments).unwrap()[0]), Some("ls"));
    }

    #[test]
    fn doubling_through_the_memo_stays_small() {
        let mut bytes = b"\x80\x02]q\x00".to_vec();
        for _ in 0..1000 {
            bytes.extend(b"h\x00h\x00\x86q\x00");
        }
        bytes.push(b'.');
        assert_eq!(Pickle::parse(&bytes).unwrap().values.len(), 1001);
    }

    #[test]
    fn damage_is_an_error() {
        for bytes in [
            &b""[..],
            b".",
            b"\x80",
            b"(",
            b"0.",
            b"(0.",
            b"e.",
            b"h\x07.",
            b"X\xff\xff\xff\xffab",
            b"\x8d\xff\xff\xff\xff\xff\xff\xff\xff",
            b"cabc",
            b"}K\x01s.",
            b"}(K\x01u.",
            b"P1\n.",
        ] {
            let fault = Pickle::parse(bytes).unwrap_err();
            assert!(fault.starts_with("pickle, byte "), "{bytes:?}: {fault}");
        }
    }

    #[test]
    fn long_integers_have_signs() {
        assert_eq!(long(&[]), Value::Integer(0));
        assert_eq!(long(&[0xff]), Value::Integer(-1));
        assert_eq!(long(&[0xff, 0]), Value::Integer(255));
        assert_eq!(long(&[0; 9]), Value::Other);
    }
}
