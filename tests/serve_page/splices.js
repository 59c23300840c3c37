// Cases of the splicer, run in the page; returns what does not hold.
const ron = await import("/assets/ron.js"), edit = await import("/assets/edit.js");
const faults = [];
const equal = (what, got, wanted) => { if (got !== wanted) faults.push(`${what}: wanted ${JSON.stringify(wanted)}, got ${JSON.stringify(got)}`); };
const fails = (text, wanted, at) => {
  try { ron.parse(text); faults.push(`${text} is read`); } catch (error) { equal(text, `${error.message} at ${error.at}`, `${wanted} at ${at}`); }
};

// Reading.
const values = ron.parse(String.raw`#![enable(x)] (a: r#"x"y"#, b: 'c', c: -1.5e-3, d: "q\"\u{41}\n", e: Some(true), f: (1, 2., 3), g: 0x1F, h: [ ], i: { "j": 1_000 }, /* /* in */ out */)`).root.items;
equal("values", JSON.stringify(values.map(({ key, value }) => [key, value.value ?? value.kind])), JSON.stringify([["a", 'x"y'], ["b", "c"], ["c", -0.0015], ["d", 'q"A\n'], ["e", "call"], ["f", "call"], ["g", 31], ["h", "list"], ["i", "map"]]));
fails("Edit(", "wanted `)`, got the end of the text", 5);
fails("Edit(version: 1 lights: {})", 'wanted `,` or `)`, got "l"', 16);
fails('Edit(a: "x', "wanted the end of the string, got the end of the text", 10);
fails("/* /* */ Edit()", "wanted `*/`, got the end of the text", 15);
fails("Edit(version: 1))", 'wanted the end of the text, got ")"', 16);
fails("[".repeat(70), "wanted at most 64 brackets within each other, got \"[\"", 65);
equal("a place", JSON.stringify(ron.position("a\n\u{1F4A1}b", 4)), '{"line":2,"column":2}');
equal("an offset", ron.offset("a\n\u{1F4A1}b", 2, 2), 4);

// Numbers as a person writes them.
equal("numbers", [0.5, 2700, 0.1234567, 123456, -0.0001, 0.1 + 0.2, 0].map((x) => ron.digits(x)).join(" "), "0.5 2700 0.123 123000 -0.0001 0.3 0");
equal("places", [0.5, 2700, 1e-7, -0.00001, 35.04].map((x) => ron.number(x, 1)).join(" "), "0.5 2700 0 0 35");

// Entries.
const one = "Edit(version: 1)\n";
const off = edit.switchLight(one, "lamp_0", false);
equal("off", off, 'Edit(\n    version: 1,\n    lights: {\n        "lamp_0": Off,\n    },\n)\n');
equal("on again", edit.switchLight(off, "lamp_0", true), "Edit(\n    version: 1,\n)\n");
let text = edit.setChange(edit.setChange(one, "lamp_0", "Temperature", "2700"), "lamp_0", "Scale", "0.5");
equal("two changes", ron.source(text, edit.read(text).lights[0].node), "[Scale(0.5), Temperature(2700)]");
text = edit.switchLight(text, "lamp_0", false);
equal("off keeps them", /Off \/\* \[Scale\(0.5\), Temperature\(2700\)\] \*\/,/.test(text), true);
text = edit.switchLight(text, "lamp_0", true);
equal("and gives them back", edit.read(text).lights[0].text, "[Scale(0.5), Temperature(2700)]");
text = edit.setChange(text, "lamp_0", "Color", "1, 0.8, 0.6");
equal("color excludes kelvin", edit.read(text).lights[0].text, "[Scale(0.5), Color(1, 0.8, 0.6)]");
text = edit.setChange(edit.setChange(text, "lamp_0", "Move", "to: Pixel(x: 3, y: 4)"), "lamp_0", "Scale", null);
equal("moved", edit.read(text).lights[0].text, "[Move(to: Pixel(x: 3, y: 4)), Color(1, 0.8, 0.6)]");

// All else stays as it was written.
const written = `// head
#![enable(implicit_some)]
Edit(
  version: 1,   // odd blanks
  lights: {
      "lamp_0": Off, // dim, "with" a string
      /* the next one: { is, [ not ( balanced */
      "desk" : Lamp(shape: Sphere(radius: 0.06), at: Pixel(x: 210, y: 118), flux: 800), "window_0": [ Scale(0.4) , Temperature(2700) ]
  },
  materials: [ Paint(region: Mask("a /* b"), albedo: Srgb("#b5563c")) ],
)
`;
equal("a field", edit.setFields(written, "lights", "desk", { flux: "400" }), written.replace("flux: 800", "flux: 400"));
equal("a new field", edit.setFields(written, "lights", "desk", { temperature: "3000" }), written.replace("flux: 800", "flux: 800, temperature: 3000"));
equal("a field less", edit.setFields(written, "lights", "desk", { flux: null }), written.replace(", flux: 800", ""));
equal("a rename", edit.renameLight(written, "desk", "table"), written.replace('"desk"', '"table"'));
equal("an entry", edit.setChange(written, "window_0", "Scale", "0.5"), written.replace("[ Scale(0.4) , Temperature(2700) ]", "[Scale(0.5), Temperature(2700)]"));
equal("a removal", edit.removeLight(written, "desk"), written.replace('"desk" : Lamp(shape: Sphere(radius: 0.06), at: Pixel(x: 210, y: 118), flux: 800), ', ""));
equal("one more", edit.setLight(written, "new", "Off"), written.replace("Temperature(2700) ]", 'Temperature(2700) ],\n      "new": Off,'));
equal("a line less", edit.removeLight('Edit(version: 1, lights: {\n    "a": Off,\n    "b": Off,\n})', "a"), 'Edit(version: 1, lights: {\n    "b": Off,\n})');
equal("the last of a line", edit.removeLight('Edit(version: 1, lights: { "a": Off, "b": Off })', "b"), 'Edit(version: 1, lights: { "a": Off })');
equal("short lines stay", edit.setLight('Edit(version: 1, lights: { "a": Off })', "b", "Off"), 'Edit(version: 1, lights: { "a": Off, "b": Off })');
const hidden = edit.switchEntry(written, "lights", edit.light(edit.read(written), "desk"), false);
equal("commented out", edit.light(edit.read(hidden), "desk").off !== undefined && !ron.parse(hidden).root.items[1].value.items.some((i) => i.key.value === "desk"), true);
equal("and in", edit.switchEntry(hidden, "lights", edit.light(edit.read(hidden), "desk"), true), written);

// The sun keeps its other fields.
const day = 'Edit(version: 1, lights: { "w": Window(corners: [(1, 1), (2, 1), (2, 2), (1, 2)], sun: Direction(azimuth: 1, elevation: 2, bandwidth: 100)) })';
equal("the sun", edit.setSun(day, "w", { azimuth: 30, elevation: 40.25 }), day.replace("azimuth: 1, elevation: 2", "azimuth: 30, elevation: 40.3"));

// Two at once.
const theirs = edit.setLight(one, "b", "Off");
equal("merged", edit.read(edit.merge(one, off, theirs)).lights.map((each) => each.id).join(), "b,lamp_0");
equal("a removal is kept", edit.merge(off, one, edit.setLight(off, "b", "Off")), theirs);
equal("theirs alone", edit.merge(one, one, theirs), theirs);

// Any order of splices gives a text that reads as it should: a small random walk, the same each time.
let seed = 1;
const random = (n) => { seed = (seed * 48271) % 2147483647; return seed % n; };
for (let walk = 0; walk < 200; walk++) {
  let now = [one, written, day, 'Edit(\n    version: 1,\n    lights: {},\n)\n', 'Edit(version: 1, lights: { "a": Off, /* "c": Lamp(flux: 1), */ })'][random(5)];
  const wanted = new Map(edit.read(now).lights.filter((each) => !each.off).map((each) => [each.id, each.text]));
  for (let k = 0; k < 12; k++) {
    const id = ["a", "b", "lamp_0", "desk"][random(4)];
    if (random(3) > 0) {
      const value = ["Off", "Scale(0.5)", 'Lamp(shape: Sphere(radius: 0.06), at: Pixel(x: 210, y: 118), flux: 800, temperature: 2700)'][random(3)];
      now = edit.setLight(now, id, value);
      wanted.set(id, value);
    } else if (wanted.has(id)) {
      now = edit.removeLight(now, id);
      wanted.delete(id);
    }
    const found = edit.read(now);
    if (found.error) { faults.push(`walk ${walk}: ${found.error.message}: ${now}`); break; }
    const got = found.lights.filter((each) => !each.off).map((each) => `${each.id} ${each.text}`).sort().join("\n");
    const want = [...wanted].map(([key, value]) => `${key} ${value}`).sort().join("\n");
    if (got !== want) { faults.push(`walk ${walk}: ${now}`); break; }
  }
}

// Weights.
const white = () => [2, 1, 0.3];
const weight = (now, made, start) => edit.weight(now, made, start, white).weight.map((x) => Number(x.toFixed(4))).join();
equal("dimmed", weight("[Scale(0.5), Temperature(2700)]", null, [1, 1, 1]), "1,0.5,0.15");
equal("dark", weight("Off", null, [1, 1, 1]), "0,0,0");
equal("as it is", weight(null, null, [1, 1, 1]), "1,1,1");
equal("fewer lumens", weight("Lamp(shape: S(1), flux: 400)", "Lamp(flux: 800, shape: S(1))", undefined), "0.5,0.5,0.5");
equal("a color", weight("Color(0, 1, 0)", null, [0.5, 0.5, 0.5]), "0,1.3982,0");
return faults;
