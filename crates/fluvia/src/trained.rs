//! Trained networks: those of files, and those that come with the program, the files of assets/weights, by name.

use std::path::Path;

use anyhow::Result;
use fluvia_net::weights::{self, Weights};

use crate::record::{Source, or_shipped, read_source, sha256};

const SHIPPED: [(&str, &[u8]); 2] = [
    (DEFAULT, include_bytes!("../../../assets/weights/default.safetensors")),
    ("viscosity", include_bytes!("../../../assets/weights/viscosity.safetensors")),
];

/// The name of the weights that count where none are given.
pub const DEFAULT: &str = "default";

/// The content of the shipped weights of that name; `None` where it is that of a file.
pub fn shipped(name: &Path) -> Option<&'static [u8]> {
    let found = SHIPPED.iter().find(|(shipped, _)| Path::new(shipped) == name)?;
    (!name.is_file()).then_some(found.1)
}

/// The names that [`shipped`] knows.
pub fn shipped_names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|(name, _)| *name)
}

/// The weights of that path, or the shipped ones of that name.
///
/// # Errors
/// If there is no such file, or it holds no network.
pub fn load(name: &Path) -> Result<(Weights, Source)> {
    let (bytes, source) = match shipped(name) {
        Some(bytes) => (bytes.to_vec(), Source { name: name.display().to_string(), sha256: sha256(bytes) }),
        None => read_source(name).map_err(|error| or_shipped(error, name, "weights", shipped_names()))?,
    };
    Ok((weights::from_bytes(name, bytes)?, source))
}

#[cfg(test)]
mod tests {
    use cconv::Kernel;
    use fluvia_net::config::Integration;
    use fluvia_net::evaluate::lone_acceleration;
    use fluvia_net::solver::NetSolver;
    use fluvia_sim::metrics::{density_ratios, mean_speed, spread};
    use fluvia_sim::particles::Boundary;
    use fluvia_sim::rollout::{Rollout, State};
    use fluvia_sim::scene::Scene;
    use fluvia_sim::substep::Substep;

    use super::*;
    use crate::options::PrecisionName;
    use crate::solvers::{Choice, PUBLISHED_STEP, SolverName};

    #[test]
    fn shipped_weights_are_ours_and_say_how_they_were_trained() {
        for (name, bytes) in SHIPPED {
            let (weights, source) = load(Path::new(name)).unwrap();
            assert_eq!((source.name.as_str(), source.sha256), (name, sha256(bytes)));
            assert_eq!(weights.config.integration, Integration::Velocity);
            assert_eq!(weights.config.extra_inputs.contains(&"viscosity".to_owned()), name == "viscosity");
            let training: serde_json::Value =
                serde_json::from_str(weights.training.as_deref().unwrap()).unwrap();
            let number = |value: &serde_json::Value| value.as_f64().unwrap_or_default();
            // A training in several parts: all of them.
            let mut part = &training;
            while !part.is_null() {
                let of_part = [&part["updates"], &part["seconds"], &part["validation"]["err_n2_mm"]];
                assert!(of_part.iter().all(|value| number(value) > 0.0), "{name}: {part}");
                let settings = &part["settings"];
                let sets = settings["data"]["sets"].as_array().unwrap();
                assert!(
                    !sets.is_empty() && sets.iter().all(|set| set["seed"].is_u64()),
                    "{name}: {settings}"
                );
                assert!(settings["made_with"]["processor"].is_string(), "{name}: {settings}");
                part = &settings["first_weights"]["training"];
            }
        }
    }

    /// A block of 1,000 particles that falls into a pool of its own: none is lost, and after 6 s it is still and not compressed.
    #[test]
    fn shipped_weights_let_a_fluid_fall_and_rest() {
        const SCENE: &str = r#"{
          "walls": [{"shape": "container", "scale": [1, 1.5, 1]}],
          "fluids": [{"shape": "box", "scale": 0.5, "translation": [0.1, 0.5, -0.1]}]
        }"#;
        let setup = Scene::parse(SCENE.as_bytes(), "block.json").unwrap().sample(0).unwrap();
        for name in shipped_names() {
            let (weights, _) = load(Path::new(name)).unwrap();
            let kernel = Kernel::detect();
            let nowhere = Boundary::default();
            let mut lone = NetSolver::new(&weights, &nowhere, &[None], kernel).unwrap();
            let [x, y, z] = lone_acceleration(&mut lone, setup.gravity, setup.dt).unwrap().unwrap();
            assert!((y + 9.81).abs() < 0.0981 && x.abs().max(z.abs()) < 0.0981, "{name}: {x} {y} {z}");

            let mut solver = NetSolver::new(&weights, &setup.boundary, &[None], kernel).unwrap();
            let mut rollout = Rollout::new(&setup).unwrap();
            for _ in 0..300 {
                rollout.advance(&mut solver).unwrap();
            }
            let State { particles, summary, .. } = rollout.state();
            let density = density_ratios(&particles.position, &[], setup.particle_radius);
            let dense = density.iter().filter(|ratio| **ratio > 1.1).count();
            let speed = mean_speed(&particles.velocity);
            println!("{name}: {} particles, {dense} dense, {speed} m/s, {summary:?}", particles.len());
            assert_eq!((particles.len(), summary.worst_outside), (1000, 0), "{name}");
            assert!(dense < 10 && speed < 0.1, "{name}: {dense} dense, {speed} m/s");
        }
    }

    /// A cube in an open container flows apart the slower the more viscous it is, as far as the solver has it that made the
    /// training data: within 20 %, of which docs/replicate.md, where these figures are, has 13.
    #[test]
    fn a_liquid_spreads_as_its_viscosity_has_it() {
        let dfsph = SolverName::Dfsph.choice(Some(Substep::Fixed(PUBLISHED_STEP)));
        let network = Choice::Network(Box::new(load(Path::new("viscosity")).unwrap().0), PrecisionName::F32);
        let mut last = f64::INFINITY;
        for viscosity in [0.01, 0.03, 0.1, 0.2, 0.3] {
            let scene = format!(
                r#"{{
                  "walls": [{{"shape": "container", "scale": [4, 2, 2]}}],
                  "fluids": [{{"shape": "box", "scale": 0.8, "translation": [0, 0.5, 0], "viscosity": {viscosity}}}]
                }}"#
            );
            let setup = Scene::parse(scene.as_bytes(), "cube.json").unwrap().sample(0).unwrap();
            let [expected, found] = [&dfsph, &network].map(|choice| {
                let mut solver = choice.make(&setup, Kernel::detect()).unwrap();
                let mut rollout = Rollout::new(&setup).unwrap();
                for _ in 0..40 {
                    rollout.advance(&mut *solver).unwrap();
                }
                spread(&rollout.state().particles.position).unwrap()
            });
            println!("viscosity {viscosity}: {found:.3} m, DFSPH {expected:.3} m");
            assert!(
                (found / expected - 1.0).abs() < 0.2,
                "viscosity {viscosity}: {found} m, DFSPH {expected} m"
            );
            assert!(found < last, "viscosity {viscosity}: {found} m, {last} m for the one before");
            last = found;
        }
    }
}
