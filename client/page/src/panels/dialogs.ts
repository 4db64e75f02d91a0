// Dialogs: a recording, a phone, the token.

import { isToken, type Api } from "../lib/api";
import { byId, element } from "../lib/dom";
import { messageOf, reportError } from "./notices";

export function dialogs(api: Api): void {
  const open = (id: string) => {
    byId<HTMLDialogElement>(id).showModal();
    if (id === "phone-dialog") {
      showPairing(api).catch((error) => byId("phone-body").replaceChildren(element("p", { class: "error" }, messageOf(error))));
    }
  };
  byId("open-recording").addEventListener("click", () => open("recording-dialog"));
  byId("open-phone").addEventListener("click", () => open("phone-dialog"));
  for (const button of document.querySelectorAll<HTMLElement>("[data-opens]")) {
    button.addEventListener("click", () => open(button.dataset["opens"]!));
  }
  for (const button of document.querySelectorAll<HTMLElement>("[data-closes]")) {
    button.addEventListener("click", () => button.closest("dialog")!.close());
  }
}

let asking: Promise<void> | null = null;

/** Ask for the token until the visitor gives one. */
export function askForToken(api: Api): Promise<void> {
  const dialog = byId<HTMLDialogElement>("token-dialog");
  const input = byId<HTMLInputElement>("token-input");
  const error = byId("token-error");
  asking ??= new Promise<void>((resolve) => {
    error.textContent = api.hasToken ? "The server does not know the token that it was given." : "";
    byId("token-form").onsubmit = (event) => {
      event.preventDefault();
      const token = input.value.trim();
      if (!isToken(token)) {
        error.textContent = "A token has plain letters, digits and signs alone (ASCII).";
        return;
      }
      api.token = token;
      asking = null;
      dialog.close();
      resolve();
    };
    dialog.onclose = () => asking && dialog.showModal(); // a browser closes it at the second Escape
    dialog.showModal();
  });
  return asking;
}

async function showPairing(api: Api): Promise<void> {
  const body = byId("phone-body");
  body.replaceChildren(element("p", { class: "hint" }, "Loading"));
  const { url, qr_svg, fingerprint, expires_in_s, advice } = await api.pairing();
  if (!url) {
    return body.replaceChildren(element("p", {}, advice ?? ""));
  }
  const code = element("img", { alt: "QR code of the address below", width: 220, height: 220 });
  code.src = `data:image/svg+xml,${encodeURIComponent(qr_svg ?? "")}`;
  body.replaceChildren(
    element("p", {}, "Scan this with a phone that reaches the address below. Its browser sends what the camera sees."),
    ...(expires_in_s ? [element("p", { class: "hint" }, `The code is for one phone, within ${Math.round(expires_in_s / 60)} minutes.`)] : []),
    ...(qr_svg ? [code] : []),
    element("p", { class: "address" }, url),
    ...(fingerprint ? [element("p", { class: "hint address" }, `If the phone warns, compare the certificate: ${fingerprint}`)] : []),
    await pairedPhones(api),
  );
}

/** The phones that have a token, each with a button that ends it. */
async function pairedPhones(api: Api): Promise<HTMLElement> {
  const rows = (await api.phones()).map(({ id, sessions, expires_in_s }) => {
    const remove = element("button", { class: "button", type: "button" }, "Remove");
    const days = `${Math.ceil(expires_in_s / 86_400)} days left`;
    const row = element("li", {}, `Phone ${id}, ${sessions.join(", ") || "no session"}, ${days} `, remove);
    remove.addEventListener("click", () => void api.removePhone(id).then(() => row.remove(), reportError));
    return row;
  });
  return element("ul", { class: "phones" }, ...rows);
}
