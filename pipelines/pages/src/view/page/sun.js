// Where the sun stands: J. Meeus, Astronomical Algorithms, 2nd ed., chapters 12, 22 and 25 (low accuracy, 0.01 degrees), with the parallax
// of the sun. Geometric, without refraction, as `heliosplat sun`.

const RAD = Math.PI / 180;

/// Azimuth clockwise from true north and elevation, degrees, at a time (milliseconds since 1970 UTC) and place (degrees).
function sunAt(time, lat, lon) {
  const days = time / 86400000 + 2440587.5 - 2451545;
  // Terrestrial time runs 64 to 75 seconds ahead between 2000 and 2050: 0.0008 degrees of the sun's way.
  const centuries = (days + 69 / 86400) / 36525;
  const meanLongitude = 280.46646 + centuries * (36000.76983 + 0.0003032 * centuries);
  const anomaly = (357.52911 + centuries * (35999.05029 - 0.0001537 * centuries)) * RAD;
  const centre =
    (1.914602 - centuries * (0.004817 + 0.000014 * centuries)) * Math.sin(anomaly) +
    (0.019993 - 0.000101 * centuries) * Math.sin(2 * anomaly) +
    0.000289 * Math.sin(3 * anomaly);
  const node = (125.04 - 1934.136 * centuries) * RAD;
  // Apparent longitude: nutation and aberration.
  const longitude = (meanLongitude + centre - 0.00569 - 0.00478 * Math.sin(node)) * RAD;
  const obliquity =
    (23.439291 - centuries * (0.0130042 + centuries * (1.64e-7 - 5.04e-7 * centuries)) + 0.00256 * Math.cos(node)) * RAD;
  const rightAscension = Math.atan2(Math.cos(obliquity) * Math.sin(longitude), Math.cos(longitude));
  const declination = Math.asin(Math.sin(obliquity) * Math.sin(longitude));
  const equinoxes = -0.00478 * Math.sin(node) * Math.cos(obliquity);
  const sidereal = (280.46061837 + 360.98564736629 * days + equinoxes + lon) * RAD;
  const hourAngle = sidereal - rightAscension;
  const phi = lat * RAD;
  const up = Math.sin(phi) * Math.sin(declination) + Math.cos(phi) * Math.cos(declination) * Math.cos(hourAngle);
  const east = -Math.cos(declination) * Math.sin(hourAngle);
  const north = Math.cos(phi) * Math.sin(declination) - Math.sin(phi) * Math.cos(declination) * Math.cos(hourAngle);
  const elevation = Math.asin(Math.max(-1, Math.min(1, up)));
  return {
    az: (Math.atan2(east, north) / RAD + 360) % 360,
    el: elevation / RAD - 0.00244 * Math.cos(elevation),
  };
}

/// Hours of local solar time: 12 when the sun crosses the meridian of the place.
function solarTime(time, lon) {
  const days = time / 86400000 + 2440587.5 - 2451545;
  const meanAnomaly = (357.529 + 0.98560028 * days) * RAD;
  const meanLongitude = 280.459 + 0.98564736 * days;
  const longitude = (meanLongitude + 1.915 * Math.sin(meanAnomaly) + 0.02 * Math.sin(2 * meanAnomaly)) * RAD;
  const rightAscension = Math.atan2(Math.cos(23.4367 * RAD) * Math.sin(longitude), Math.cos(longitude)) / RAD;
  const equation = ((((meanLongitude - rightAscension + 180) % 360) + 360) % 360) - 180;
  const hours = (time / 3600000 + (lon + equation) / 15) % 24;
  return (hours + 24) % 24;
}
