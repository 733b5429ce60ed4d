// Names of robots' makers, by the cell's names of them.
export const BRANDS = {
  ur: "Universal Robots",
  kuka: "KUKA",
  fanuc: "FANUC",
  yaskawa: "Yaskawa",
  abb: "ABB",
  staubli: "Stäubli",
  kawasaki: "Kawasaki",
  doosan: "Doosan",
  mitsubishi: "Mitsubishi",
  epson: "Epson",
  denso: "Denso",
  techman: "Techman",
};
