import {readTranslations} from "../../po.js";
import {makeTexts} from "../../src/texts.js";

export const GERMAN = readTranslations(new URL("../../locale/de.po", import.meta.url));

/** Return the texts of a page in that language: with what build.js gives it. */
export const textsIn = (language) => makeTexts(language, language === "de" ? GERMAN : {});
