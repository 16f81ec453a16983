import {readFileSync} from "node:fs";
import {tableOf} from "../../src/sentences.js";
import {makeTexts} from "../../src/texts.js";

/** Every sentence, as the robot's programs read them. */
export const SENTENCES = JSON.parse(readFileSync(new URL("../../../src/construction_twin/core/sentences.json", import.meta.url), "utf8"));

/** Return the texts of a page in that language: with what build.js gives it. */
export const textsIn = (language) => makeTexts(language, tableOf(SENTENCES, language));

/** Return the function that says any sentence in English, as the robot's programs do. */
export const robotSays = makeTexts("en", SENTENCES);
