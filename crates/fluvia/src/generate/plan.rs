//! What is to be made: the settings of a data set and the scenes that follow from them.

use std::ops::Range;

use anyhow::{Result, bail};
use fluvia_sim::frames::sequence::FRAMES_PER_PART;
use fluvia_sim::scene::random::{MATERIAL_TEST_VISCOSITIES, Recipe, Speed, Viscosity};
use fluvia_sim::substep::Substep;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Args;
use crate::options::substep;
use crate::record::decimal;
use crate::solvers::{Choice, PUBLISHED_STEP, SolverName};

/// The largest number that file names have room for.
const MOST_SCENES: u32 = 9999;

/// The paper's data sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Preset {
    /// One to three bodies in one of ten containers: 200 and 20 scenes of 16 s.
    Default,
    /// The same in a box, always 6,000 particles.
    #[value(name = "box-6k")]
    Box6k,
    /// The same as default with viscosities from 0.01 to 0.3: 200 scenes.
    Viscosity,
    /// A block of fluid in a box, with position-based fluids: 2000 and 300 scenes.
    DamBreak,
    /// Seven viscosities with a shape that no other set has: 7 validation scenes of 100 frames.
    MaterialTest,
}

impl Preset {
    fn name(self) -> &'static str {
        match self {
            Preset::Default => "default",
            Preset::Box6k => "box-6k",
            Preset::Viscosity => "viscosity",
            Preset::DamBreak => "dam-break",
            Preset::MaterialTest => "material-test",
        }
    }

    /// The paper's numbers of training and validation scenes.
    fn sizes(self) -> [u32; 2] {
        match self {
            Preset::Default | Preset::Box6k => [200, 20],
            Preset::Viscosity => [200, 0],
            Preset::DamBreak => [2000, 300],
            Preset::MaterialTest => [0, MATERIAL_TEST_VISCOSITIES.len() as u32],
        }
    }

    fn recipe(self, viscosity: f32) -> Recipe {
        match self {
            Preset::Default => Recipe::default_scenes(),
            Preset::Box6k => Recipe::box_6k(),
            Preset::Viscosity => Recipe::viscosity(),
            Preset::DamBreak => Recipe::dam_break(),
            Preset::MaterialTest => Recipe::material_test(viscosity),
        }
    }
}

/// What a data set depends on, as it is in its manifest: with the same settings the files are the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The version of the program.
    pub version: String,
    pub preset: String,
    pub seed: u64,
    /// Training scenes.
    pub scenes: u32,
    /// Validation scenes.
    pub valid: u32,
    /// Frames of a sequence.
    pub frames: u64,
    /// Seconds between them.
    pub dt: f64,
    /// The fewest and the most fluid particles of a scene.
    pub particles: [usize; 2],
    pub highest_speed: bool,
    /// The lowest and the highest viscosity of a scene, where they are not the preset's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub viscosity: Option<[f64; 2]>,
    pub solver: String,
    /// The parameters of the solver.
    pub parameters: Value,
}

/// The settings, and what they are put into practice with.
pub struct Plan {
    pub settings: Settings,
    pub solver: Choice,
    preset: Preset,
    recipe: Recipe,
}

/// Which half of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    Train,
    Valid,
}

impl Split {
    pub const fn folder(self) -> &'static str {
        match self {
            Split::Train => "train",
            Split::Valid => "valid",
        }
    }
}

/// A scene to make.
pub struct Task {
    pub split: Split,
    /// From 0 through the whole set.
    pub number: u32,
    /// The name of its sequence, sim_0001 for the first.
    pub name: String,
}

impl Plan {
    pub fn new(args: &Args) -> Result<Plan> {
        let preset = args.preset;
        let mut recipe = preset.recipe(MATERIAL_TEST_VISCOSITIES[0]);
        recipe.duration = args.duration.unwrap_or(recipe.duration);
        recipe.particles = args.particles.clone().unwrap_or(recipe.particles);
        if args.highest_speed {
            recipe.speed = Speed::Highest;
        }
        if let Some(range) = &args.viscosity {
            if matches!(recipe.viscosity, Viscosity::Unset) || preset == Preset::MaterialTest {
                bail!(
                    "--viscosity: not with --preset {}, expected default, box-6k or viscosity",
                    preset.name()
                );
            }
            recipe.viscosity = Viscosity::Uniform(range.clone());
        }
        let [scenes, valid] = preset.sizes();
        let (scenes, valid) = (args.scenes.unwrap_or(scenes), args.valid.unwrap_or(valid));
        if scenes.checked_add(valid).is_none_or(|total| total > MOST_SCENES) {
            bail!("--scenes {scenes} --valid {valid}: more than {MOST_SCENES} scenes");
        }
        let substep = substep(args.solver_dt, args.solver_dt_max, recipe.dt)?;
        let solver = match preset {
            Preset::DamBreak => SolverName::Pbf.choice(substep),
            _ => SolverName::Dfsph.choice(substep.or(Some(Substep::Fixed(PUBLISHED_STEP)))),
        };
        let frames = (f64::from(recipe.duration) / f64::from(recipe.dt)).round() as u64;
        if frames < 2 {
            bail!("--duration: {} s, expected at least two frames of {} s", recipe.duration, recipe.dt);
        }
        let settings = Settings {
            version: env!("CARGO_PKG_VERSION").into(),
            preset: preset.name().into(),
            seed: args.seed,
            scenes,
            valid,
            frames,
            dt: decimal(recipe.dt),
            particles: [*recipe.particles.start(), *recipe.particles.end()],
            highest_speed: args.highest_speed,
            viscosity: args.viscosity.as_ref().map(|range| [range.start(), range.end()].map(|x| decimal(*x))),
            solver: solver.name().into(),
            parameters: solver.parameters(),
        };
        Ok(Plan { settings, solver, preset, recipe })
    }

    /// All scenes of the set: training first.
    pub fn tasks(&self) -> impl Iterator<Item = Task> {
        let Settings { scenes, valid, .. } = self.settings;
        (0..scenes + valid).map(move |number| Task {
            split: if number < scenes { Split::Train } else { Split::Valid },
            number,
            name: format!("sim_{:04}", number + 1),
        })
    }

    /// Steps of a scene, one less than its frames.
    pub fn steps(&self) -> u64 {
        self.settings.frames - 1
    }

    /// The parts that are whole when so many frames of a scene are there: the last part may have fewer frames.
    pub fn whole_parts(&self, frames: u64) -> u64 {
        let length = FRAMES_PER_PART as u64;
        if frames == self.settings.frames { frames.div_ceil(length) } else { frames / length }
    }

    /// The frames that belong to no whole part when so many are there.
    pub fn open_frames(&self, frames: u64) -> Range<u64> {
        let kept = self.whole_parts(frames) * FRAMES_PER_PART as u64;
        kept.min(frames)..frames
    }

    /// What a scene is drawn from, and the seed to draw it with. Attempts after the first are for scenes that blew up.
    pub fn draw(&self, task: &Task, attempt: u32) -> (Recipe, u64) {
        let kinds = MATERIAL_TEST_VISCOSITIES.len() as u32;
        let (recipe, number) = match self.preset {
            // The scenes of the seven viscosities are the same but for them.
            Preset::MaterialTest => {
                let recipe = self.preset.recipe(MATERIAL_TEST_VISCOSITIES[(task.number % kinds) as usize]);
                let Recipe { viscosity, .. } = recipe;
                (Recipe { viscosity, ..self.recipe.clone() }, task.number / kinds)
            }
            _ => (self.recipe.clone(), task.number),
        };
        (recipe, scene_seed(self.settings.seed, number, attempt))
    }
}

/// The seed of one scene of a set: the bits are mixed so that near numbers have nothing in common (the finalizer of
/// SplitMix64, Steele et al. 2014). It has 53 bits, so that every reader of JSON keeps it.
fn scene_seed(seed: u64, number: u32, attempt: u32) -> u64 {
    let mut bits = seed;
    for word in [u64::from(number), u64::from(attempt)] {
        bits = bits.wrapping_add(word.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^= bits >> 31;
    }
    bits >> 11
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_whole_with_fifty_frames_or_the_last() {
        let plan = |frames: u64| {
            let arguments =
                ["--preset", "default", "--out", "out", "--duration", &(0.02 * frames as f64).to_string()];
            let args = <Line as clap::Parser>::parse_from(std::iter::once("fluvia").chain(arguments));
            Plan::new(&args.args).unwrap()
        };
        let (short, long) = (plan(55), plan(100));
        assert_eq!((short.settings.frames, long.settings.frames), (55, 100));
        for (frames, whole) in [(1, 0), (49, 0), (50, 1), (51, 1), (54, 1), (55, 2)] {
            assert_eq!(short.whole_parts(frames), whole, "{frames}");
        }
        for (frames, open) in [(1, 0..1), (49, 0..49), (50, 50..50), (54, 50..54), (55, 55..55)] {
            assert_eq!(short.open_frames(frames), open, "{frames}");
        }
        assert_eq!((long.whole_parts(99), long.whole_parts(100)), (1, 2));
        assert_eq!((long.open_frames(99), long.open_frames(100)), (50..99, 100..100));
    }

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn seeds_of_scenes_differ() {
        let mut seeds: Vec<u64> = (0..3)
            .flat_map(|seed| (0..50).flat_map(move |n| (0..3).map(move |k| scene_seed(seed, n, k))))
            .collect();
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!(seeds.len(), 3 * 50 * 3);
        // Never to change: data sets are named by their seed.
        assert_eq!(scene_seed(0, 0, 0), 12035550249420947055 >> 11);
    }
}
