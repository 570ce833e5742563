//! A k-d tree: which points lie near another.

use crate::vector::finite;

/// Points with their indices, sorted into a tree: the median along an axis in the middle, the smaller before it.
#[derive(Clone, Debug)]
pub(crate) struct Tree(Vec<Entry>);

#[derive(Clone, Copy, Debug)]
struct Entry {
    position: [f32; 3],
    index: u32,
}

/// Points in a leaf of the tree, which are simply tried.
const LEAF: usize = 16;

impl Tree {
    /// The tree of the points that are finite.
    pub fn new(position: &[[f32; 3]]) -> Tree {
        let entries = position.iter().zip(0..).map(|(&position, index)| Entry { position, index });
        let mut entries: Vec<Entry> = entries.filter(|entry| finite(&entry.position)).collect();
        build(&mut entries, 0);
        Tree(entries)
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Calls `found` with the index of each point whose squared distance from `p` is at most `limit`, with that
    /// distance and the limit, which it may lower.
    pub fn visit(&self, p: &[f32; 3], mut limit: f32, mut found: impl FnMut(usize, f32, &mut f32)) {
        visit(&self.0, 0, p, &mut limit, &mut found);
    }

    /// The squared distance of the nearest point; infinite if there is none.
    pub fn nearest(&self, p: &[f32; 3]) -> f32 {
        let mut nearest = f32::INFINITY;
        self.visit(p, f32::INFINITY, |_, squared, limit| {
            *limit = squared;
            nearest = squared;
        });
        nearest
    }
}

fn build(entries: &mut [Entry], axis: usize) {
    if entries.len() <= LEAF {
        return;
    }
    let middle = entries.len() / 2;
    // The index decides between equal places, so that the tree is the same whatever the sorting does with them.
    entries.select_nth_unstable_by(middle, |a, b| {
        a.position[axis].total_cmp(&b.position[axis]).then(a.index.cmp(&b.index))
    });
    let (before, after) = entries.split_at_mut(middle);
    build(before, (axis + 1) % 3);
    build(&mut after[1..], (axis + 1) % 3);
}

fn visit(
    entries: &[Entry],
    axis: usize,
    p: &[f32; 3],
    limit: &mut f32,
    found: &mut impl FnMut(usize, f32, &mut f32),
) {
    let mut attempt = |entry: &Entry, limit: &mut f32| {
        let squared = (0..3).map(|k| (p[k] - entry.position[k]).powi(2)).sum::<f32>();
        if squared <= *limit {
            found(entry.index as usize, squared, limit);
        }
    };
    if entries.len() <= LEAF {
        entries.iter().for_each(|entry| attempt(entry, limit));
        return;
    }
    let middle = entries.len() / 2;
    attempt(&entries[middle], limit);
    let offset = p[axis] - entries[middle].position[axis];
    let (before, after) = (&entries[..middle], &entries[middle + 1..]);
    let (near, far) = if offset < 0.0 { (before, after) } else { (after, before) };
    visit(near, (axis + 1) % 3, p, limit, found);
    if offset * offset <= *limit {
        visit(far, (axis + 1) % 3, p, limit, found);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tree_finds_the_points_within_a_distance() {
        let at = |steps: [f32; 3], i: usize| steps.map(|step| (step * i as f32).fract());
        let mut points: Vec<_> = (0..500).map(|i| at([0.618_034, 0.754_877, 0.569_84], i)).collect();
        points.push([f32::NAN, 0.0, 0.0]);
        let tree = Tree::new(&points);
        for i in 0..200 {
            let p = at([0.37, 0.61, 0.83], i).map(|x| 1.4 * x - 0.2);
            let squared = |q: &[f32; 3]| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>();
            let expected = points[..500].iter().map(squared).fold(f32::INFINITY, f32::min);
            assert_eq!(tree.nearest(&p), expected);
            let mut found = Vec::new();
            tree.visit(&p, 0.04, |index, _, _| found.push(index));
            found.sort_unstable();
            let expected: Vec<usize> = (0..500).filter(|&j| squared(&points[j]) <= 0.04).collect();
            assert_eq!(found, expected);
        }
        assert_eq!(Tree::new(&[]).nearest(&[0.0; 3]), f32::INFINITY);
    }
}
