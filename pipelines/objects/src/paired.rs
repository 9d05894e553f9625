//! Comparison of two short fits: the gain of a component on pixels that neither fit was trained on, and its
//! significance.
//!
//! Both fits are scored on the same pieces of images. The gain is the ratio of their squared errors in decibels, like a
//! difference of PSNR; its standard error is that of a ratio of sums, by linear propagation (the delta method; Cochran
//! 1977, chapter 6).

/// Fewest pieces for a standard error.
const FEWEST_PIECES: usize = 5;
/// Standard errors by which a gain must differ from zero.
const STANDARD_ERRORS: f64 = 2.0;

/// Squared errors of one piece, summed over its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Piece {
    /// Squared error without the component.
    pub without: f64,
    /// Squared error with the component.
    pub with: f64,
}

/// Gain of a component on held-out pixels.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Gain {
    /// Squared error without the component over that with it, decibels: above zero it helps.
    pub gain_db: f64,
    /// Standard error of the gain, decibels.
    pub standard_error_db: f64,
    /// Number of pieces compared.
    pub pieces: usize,
}

/// Conclusion from a gain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The component helps.
    Better,
    /// The component harms.
    Worse,
    /// The gain is within chance, or below the least one.
    Undecided,
}

impl Gain {
    /// Gain over all pieces whose errors are finite and not both zero; `None` for fewer than five such pieces.
    pub fn of(pieces: &[Piece]) -> Option<Self> {
        let sound = |piece: &&Piece| {
            let Piece { without, with } = piece;
            without.is_finite() && with.is_finite() && without + with > 0.0
        };
        let pieces: Vec<&Piece> = pieces.iter().filter(sound).collect();
        let without: f64 = pieces.iter().map(|piece| piece.without).sum();
        let with: f64 = pieces.iter().map(|piece| piece.with).sum();
        if pieces.len() < FEWEST_PIECES || without <= 0.0 || with <= 0.0 {
            return None;
        }
        // d ln(A / B) = dA / A - dB / B: contribution of each piece; the sum over all is zero.
        let squares = pieces
            .iter()
            .map(|piece| (piece.without / without - piece.with / with).powi(2));
        let count = pieces.len() as f64;
        let sum_error = (squares.sum::<f64>() * count / (count - 1.0)).sqrt();
        let db = 10.0 / std::f64::consts::LN_10;
        Some(Self {
            gain_db: db * (without / with).ln(),
            standard_error_db: db * sum_error,
            pieces: pieces.len(),
        })
    }

    /// Conclusion: better or worse where the gain is more than two standard errors and more than `least_db` decibels
    /// from zero, else undecided.
    pub fn verdict(&self, least_db: f64) -> Verdict {
        let beyond = self.gain_db.abs() > STANDARD_ERRORS * self.standard_error_db && self.gain_db.abs() > least_db;
        match (beyond, self.gain_db > 0.0) {
            (false, _) => Verdict::Undecided,
            (true, true) => Verdict::Better,
            (true, false) => Verdict::Worse,
        }
    }

    /// Gain and standard error as text, such as `+0.31 ± 0.05 dB`.
    pub fn in_words(&self) -> String {
        format!("{:+.2} ± {:.2} dB", self.gain_db, self.standard_error_db)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg32;

    fn piece(without: f64, with: f64) -> Piece {
        Piece { without, with }
    }

    #[test]
    fn half_the_squared_error_everywhere_is_three_decibels_without_any_doubt() {
        let pieces: Vec<Piece> = (1..9).map(|n| piece(2.0 * f64::from(n), f64::from(n))).collect();
        let gain = Gain::of(&pieces).expect("eight pieces");
        assert!((gain.gain_db - 3.0103).abs() < 1e-3 && gain.standard_error_db < 1e-9);
        assert_eq!(gain.verdict(0.0), Verdict::Better);
        assert_eq!(gain.verdict(4.0), Verdict::Undecided);
    }

    #[test]
    fn the_other_way_round_the_gain_is_a_loss_of_the_same_size() {
        let pieces = [(3.0, 2.0), (1.0, 0.7), (2.0, 1.3), (4.0, 2.9), (1.0, 0.7)];
        let there = Gain::of(&pieces.map(|(a, b)| piece(a, b))).expect("five pieces");
        let back = Gain::of(&pieces.map(|(a, b)| piece(b, a))).expect("five pieces");
        assert!((there.gain_db + back.gain_db).abs() < 1e-12);
        assert!((there.standard_error_db - back.standard_error_db).abs() < 1e-12);
        assert_eq!(back.verdict(0.0), Verdict::Worse);
    }

    #[test]
    fn one_piece_that_gains_much_does_not_decide_for_all() {
        let mut pieces = vec![piece(1.0, 1.0); 9];
        pieces.push(piece(4.0, 1.0));
        let gain = Gain::of(&pieces).expect("ten pieces");
        assert!(
            gain.gain_db > 1.0 && gain.verdict(0.0) == Verdict::Undecided,
            "{gain:?}"
        );
    }

    #[test]
    fn too_few_pieces_and_pieces_without_errors_say_nothing() {
        assert_eq!(Gain::of(&[piece(2.0, 1.0); 4]), None);
        assert_eq!(Gain::of(&[piece(0.0, 0.0); 20]), None);
        assert_eq!(Gain::of(&[piece(f64::NAN, 1.0); 20]), None);
    }

    #[test]
    fn the_standard_error_is_how_much_gains_scatter_and_chance_is_seldom_taken_for_a_gain() {
        let mut random = Pcg32::seed_from_u64(7);
        let mut draw = || random.random_range(0.5..1.5);
        let gains: Vec<Gain> = (0..2000)
            .map(|_| {
                let pieces: Vec<Piece> = (0..24).map(|_| piece(draw(), draw())).collect();
                Gain::of(&pieces).expect("24 pieces")
            })
            .collect();
        let count = gains.len() as f64;
        let scatter = (gains.iter().map(|gain| gain.gain_db.powi(2)).sum::<f64>() / count).sqrt();
        let stated = gains.iter().map(|gain| gain.standard_error_db).sum::<f64>() / count;
        assert!((scatter / stated - 1.0).abs() < 0.05, "{scatter} {stated}");
        let taken = gains.iter().filter(|gain| gain.verdict(0.0) == Verdict::Better).count();
        assert!(taken as f64 / count < 0.045, "{taken}");
    }
}
