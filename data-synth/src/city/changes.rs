//! Buildings built and torn down between the images.

use super::building::Building;
use crate::noise::stream;
use rand::RngExt;
use rand::seq::IndexedRandom;

/// Least ground area of a building that changes, m²; smaller buildings are no houses.
const LEAST_M2: f64 = 30.0;

/// One building's change.
#[derive(Debug, Clone, Copy)]
struct Change {
    /// The first date that shows the new state.
    date: usize,
    /// True if the building is built on that date, false if it is torn down.
    built: bool,
}

/// The changes of a city, by building; none by default.
#[derive(Debug, Default)]
pub(crate) struct Changes {
    of_building: Vec<Option<Change>>,
}

impl Changes {
    /// Lets `share` (0 to 1) of the larger buildings change, each on one of the dates `on`. They are spread evenly
    /// outward from the centre, so that every site has some.
    pub(super) fn new(seed: u64, buildings: &[Building], share: f64, on: &[usize]) -> Self {
        let mut random = stream(seed, 0xC4A6);
        let area_m2 = |building: &Building| 4.0 * building.footprint.half[0] * building.footprint.half[1];
        let from_centre_m = |index: usize| buildings[index].footprint.x.hypot(buildings[index].footprint.y);
        let mut houses: Vec<usize> = (0..buildings.len())
            .filter(|&index| area_m2(&buildings[index]) >= LEAST_M2)
            .collect();
        houses.sort_by(|&a, &b| from_centre_m(a).total_cmp(&from_centre_m(b)).then(a.cmp(&b)));
        let mut of_building = vec![None; buildings.len()];
        let mut due = random.random_range(0.0..1.0);
        for index in houses {
            due += share;
            if due >= 1.0 {
                due -= 1.0;
                of_building[index] = on.choose(&mut random).map(|&date| Change {
                    date,
                    built: random.random_bool(0.5),
                });
            }
        }
        Self { of_building }
    }

    /// True if a building stands on a date.
    pub(super) fn stands(&self, building: usize, date: usize) -> bool {
        (self.change(building)).is_none_or(|change| (date >= change.date) == change.built)
    }

    /// The first date that shows a building's new state, if it changes.
    pub(super) fn date(&self, building: usize) -> Option<usize> {
        self.change(building).map(|change| change.date)
    }

    fn change(&self, building: usize) -> Option<Change> {
        self.of_building.get(building).copied().flatten()
    }
}
