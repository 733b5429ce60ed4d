// How a PLC reads the map, by the values it shows for known words: word order, byte order, address offset.
const asInteger = (text) => {
  const plain = text.trim().replace(/[\s_']/g, "");
  const hexadecimal = /^(?:0x|16#|w#16#|dw#16#)([0-9a-f]+)$/i.exec(plain);
  if (hexadecimal) return parseInt(hexadecimal[1], 16);
  return /^-?\d+$/.test(plain) ? Number(plain) : NaN;
};
const asFloat = (text) => {
  const plain = text.trim().replace(",", ".");
  return /^-?\d*\.?\d+(?:e[-+]?\d+)?$/i.test(plain) ? Number(plain) : NaN;
};

const turned = (word) => ((word & 0xff) << 8) | (word >> 8);

// The words as the cell sends them, from MAGIC on.
function sent({ probes, word_order }) {
  const value = Object.fromEntries(probes.map((one) => [one.name, one.value]));
  const view = new DataView(new ArrayBuffer(8));
  view.setUint32(0, value.PROBE_U32);
  view.setFloat32(4, value.PROBE_F32);
  const pair = (at) => {
    const words = [view.getUint16(at), view.getUint16(at + 2)];
    return word_order === "low" ? words.reverse() : words;
  };
  return [value.MAGIC, value.MAP_VERSION, ...pair(0), ...pair(4)];
}

const START = { MAGIC: 0, PROBE_U32: 2, PROBE_F32: 4 };
const isNear = (a, b) => Math.abs(a - b) <= 1e-4 * Math.max(Math.abs(b), 1e-30);

// "right"; "words", "bytes", "both": exchanged; "high", "low": one address off; "half"; "other"; "no-number".
export function verdictOf(name, text, plc) {
  const words = sent(plc);
  const isFloat = name === "PROBE_F32";
  const said = isFloat ? asFloat(text) : asInteger(text);
  if (!Number.isFinite(said)) return "no-number";
  const start = START[name];
  if (name === "MAGIC") {
    const whole = said & 0xffff;
    if (whole === words[0]) return "right";
    if (whole === turned(words[0])) return "bytes";
    return whole === words[1] ? "high" : "other";
  }
  const isHighFirst = plc.word_order === "high";
  const read = (at, isTurned, areBytesTurned) => {
    const pair = words.slice(at, at + 2).map((word) => (areBytesTurned ? turned(word) : word));
    if (isHighFirst === isTurned) pair.reverse(); // as a client with the other word order
    const view = new DataView(new ArrayBuffer(4));
    view.setUint16(0, pair[0]);
    view.setUint16(2, pair[1]);
    return isFloat ? view.getFloat32(0) : view.getUint32(0);
  };
  const fits = (...how) => (isFloat ? isNear(said, read(...how)) : said >>> 0 === read(...how));
  const ways = [
    ["right", false, false],
    ["words", true, false],
    ["bytes", false, true],
    ["both", true, true],
  ];
  const found = ways.find(([, isTurned, areBytesTurned]) => fits(start, isTurned, areBytesTurned));
  if (found) return found[0];
  for (const [off, verdict] of [
    [1, "high"],
    [-1, "low"],
  ])
    if (start + off + 1 < words.length && ways.some(([, ...how]) => fits(start + off, ...how)))
      return verdict;
  return words.slice(start, start + 2).includes(said) ? "half" : "other";
}
